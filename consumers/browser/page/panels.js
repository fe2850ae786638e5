// The panels above and below the views: a problem, the verdict of a verification, the legend and the times of stages.

import { readable } from './box-style.js';

const STAGES = {
  decode: ['images', '#8a94a6'],
  preprocess: ['preprocess', '#5b8def'],
  backbone: ['backbone', '#e0673a'],
  projector: ['projector', '#b58bf0'],
  lifter: ['lifter', '#2ea99b'],
  decoder: ['decoder', '#d9a514'],
  segmenter: ['segmenter', '#d15fa2'],
  postprocess: ['postprocess', '#6b7280'],
};
const TITLES = {
  bundle: 'This bundle cannot be used',
  scene: 'This scene cannot be used',
  files: 'These files cannot be used',
  page: 'Something in this page failed',
};
const SHOWN_DIFFERENCES = 8;

/** Show what was expected, what was found, and what to do. */
export function showProblem(place, { part, where, expected, found, remedy }) {
  const rows = [
    ['Where', where],
    ['Expected', expected],
    ['Found', found],
    ['What to do', remedy],
  ];
  const list = document.createElement('dl');
  for (const [name, text] of rows.filter(([, text]) => text)) list.append(element('dt', name), element('dd', text));
  place.replaceChildren(element('h2', TITLES[part] ?? TITLES.files), list, closeButton(place));
  place.hidden = false;
}

/** Show the report of `verify`. */
export function showVerdict(place, report) {
  const { passed, frames, tensors, values, largestShare, count, differences } = report;
  const compared = `${frames} frames, ${tensors} tensors, ${values.toLocaleString('en')} values`;
  const title = passed ? 'Verified' : `Not verified: ${count.toLocaleString('en')} differences`;
  const text = passed
    ? `The golden example gives the expected values: ${compared}. The largest error is ${(100 * largestShare).toPrecision(2)} % of its tolerance.`
    : `Compared: ${compared}. This browser computes other values than the model, or the bundle is wrong.`;
  place.classList.toggle('failed', !passed);
  place.replaceChildren(
    element('h2', title),
    element('p', text),
    ...(passed ? [] : [differenceTable(differences)]),
    closeButton(place),
  );
  place.hidden = false;
}

/** @param {Map<string, {colour: string, count: number}>} classes */
export function showLegend(place, classes) {
  place.replaceChildren(
    ...[...classes].map(([name, { colour, count }]) => {
      const item = document.createElement('li');
      item.append(dot(colour), `${readable(name)} ${count}`);
      return item;
    }),
  );
  if (classes.size === 0) place.replaceChildren(element('li', 'No box reaches the minimum score.'));
}

/** Show the time of each stage as a bar and as numbers. */
export function showStages(place, timings) {
  const stages = Object.entries(STAGES).filter(([stage]) => timings[stage] !== undefined);
  const total = stages.reduce((sum, [stage]) => sum + timings[stage], 0);
  const track = element('div', '', 'track');
  const list = document.createElement('ul');
  if (total > 0) list.append(item('', 'total', milliseconds(total)));
  for (const [stage, [name, colour]] of stages) {
    const part = document.createElement('div');
    Object.assign(part.style, { width: `${(100 * timings[stage]) / total}%`, background: colour });
    part.title = `${name}: ${milliseconds(timings[stage])}`;
    track.append(part);
    list.append(item(colour, name, milliseconds(timings[stage])));
  }
  place.replaceChildren(track, list);
}

function item(colour, name, value) {
  const entry = document.createElement('li');
  entry.append(...(colour ? [dot(colour)] : []), `${name} `, element('b', value));
  return entry;
}

function milliseconds(value) {
  return `${value >= 9.95 || value < 0.05 ? Math.round(value) : value.toFixed(1)} ms`;
}

function differenceTable(differences) {
  const table = document.createElement('table');
  const row = (tag, texts) => {
    const line = document.createElement('tr');
    line.append(...texts.map((text) => element(tag, text)));
    return line;
  };
  table.append(row('th', ['frame', 'tensor', 'index', 'expected', 'found']));
  for (const { frame, tensor, index, expected, found } of differences.slice(0, SHOWN_DIFFERENCES)) {
    table.append(row('td', [frame, tensor, index, expected, found]));
  }
  return table;
}

function closeButton(place) {
  const button = element('button', '×', 'close');
  button.type = 'button';
  button.setAttribute('aria-label', 'Close');
  button.addEventListener('click', () => {
    place.hidden = true;
  });
  return button;
}

function dot(colour) {
  const mark = document.createElement('i');
  mark.style.background = colour;
  return mark;
}

function element(tag, text, className = '') {
  const created = document.createElement(tag);
  created.textContent = text;
  created.className = className;
  return created;
}
