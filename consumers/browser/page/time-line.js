// The time line: buttons, the scrub bar, and marks of the frames that were computed.

import { fit } from './canvas.js';

const PLAY = 'M4.5 2.5v11l9-5.5z';
const PAUSE = 'M4 2.5h3v11H4z M9 2.5h3v11H9z';
const COLOURS = { computed: '#3b82f6', skipped: '#9aa3b0', waiting: 'rgb(128 136 150 / 28%)' };

export class TimeLine {
  /** @param {(index: number) => void} onSelect called with the frame that the user chooses */
  constructor(elements, onSelect, onPlay) {
    Object.assign(this, { elements, onSelect, count: 0, index: 0, isPlaying: false });
    const { back, play, forward, scrub } = elements;
    back.addEventListener('click', () => this.choose(this.index - 1));
    forward.addEventListener('click', () => this.choose(this.index + 1));
    play.addEventListener('click', () => onPlay(!this.isPlaying));
    scrub.addEventListener('input', () => this.choose(Number(scrub.value)));
    window.addEventListener('keydown', (event) => this.onKey(event, onPlay));
  }

  start(count) {
    Object.assign(this, { count, index: 0 });
    this.elements.scrub.max = String(count - 1);
  }

  choose(index) {
    if (index < 0 || index >= this.count) return;
    this.index = index;
    this.elements.scrub.value = String(index);
    this.onSelect(index);
  }

  setPlaying(isPlaying) {
    const { play, playShape } = this.elements;
    this.isPlaying = isPlaying;
    playShape.setAttribute('d', isPlaying ? PAUSE : PLAY);
    play.setAttribute('aria-label', isPlaying ? 'Pause' : 'Play');
    play.title = isPlaying ? 'Pause (space)' : 'Play (space)';
  }

  /** @param {(index: number) => 'computed' | 'skipped' | 'waiting'} stateOf */
  draw(text, stateOf) {
    const { back, forward, position, marks } = this.elements;
    back.disabled = this.index === 0;
    forward.disabled = this.index === this.count - 1;
    position.textContent = text;
    const { context, width, height } = fit(marks);
    const step = width / this.count;
    for (let index = 0; index < this.count; index += 1) {
      context.fillStyle = COLOURS[stateOf(index)];
      context.fillRect(index * step, 1, Math.max(1, step - (step > 4 ? 1.5 : 0)), height - 2);
    }
  }

  onKey(event, onPlay) {
    if (this.count === 0 || event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target.tagName;
    if (target === 'INPUT' || (target === 'BUTTON' && event.key === ' ')) return; // they have a meaning there
    if (event.key === 'ArrowLeft') this.choose(this.index - 1);
    else if (event.key === 'ArrowRight') this.choose(this.index + 1);
    else if (event.key === ' ') onPlay(!this.isPlaying);
    else return;
    event.preventDefault();
  }
}
