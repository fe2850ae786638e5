// The page: opens files, asks the worker for frames, and shows them.

import { drawBirdEyeView } from './bird-eye-view.js';
import { classColour } from './box-style.js';
import { CameraViews } from './camera-views.js';
import { frameResult } from '../lib/results.js';
import { droppedFiles, pickedFiles } from './dropped-files.js';
import { FrameCache } from './frame-cache.js';
import { isolatePage } from './isolation.js';
import { showLegend, showProblem, showStages, showVerdict } from './panels.js';
import { TimeLine } from './time-line.js';
import { WorkerClient } from './worker-client.js';

const LONGEST_STEP_S = 0.5; // between two frames while playing
const NARROW = '(max-width: 960px)'; // as in style.css, as are the next two
const LEGEND_PX = 48;
const GAP_PX = 10;

const at = (id) => document.getElementById(id);
const state = { bundle: undefined, scene: undefined, index: 0, isBusy: false, wanted: undefined, opening: false };
const cache = new FrameCache();
const cameraViews = new CameraViews(at('cameras'));
let worker;
let timeLine;

if (!(await isolatePage())) start();

function start() {
  worker = new WorkerClient((text) => setStatus(text, true));
  timeLine = new TimeLine(
    {
      back: at('back'),
      play: at('play'),
      forward: at('forward'),
      scrub: at('scrub'),
      playShape: at('play-shape'),
      position: at('position'),
      marks: at('marks'),
    },
    select,
    play,
  );
  for (const id of ['open', 'start-open']) at(id).addEventListener('click', () => at('picker').click());
  for (const id of ['demo', 'start-demo']) at(id).addEventListener('click', openDemo);
  at('start-golden').addEventListener('click', () => open(() => worker.request('openGolden')));
  at('verify').addEventListener('click', verify);
  at('save').addEventListener('click', saveResults);
  at('picker').addEventListener('change', () => {
    const entries = pickedFiles(at('picker'));
    at('picker').value = ''; // the same folder can be picked again
    open(() => worker.request('open', { name: 'the folder', entries }));
  });
  at('score').addEventListener('input', draw);
  at('map').addEventListener('change', draw);
  new ResizeObserver(draw).observe(at('viewer'));
  window.addEventListener('resize', draw);
  acceptDrops();
  setStatus('');
  document.documentElement.dataset.ready = 'yes';
}

function acceptDrops() {
  let depth = 0;
  const setHint = (change) => {
    depth = Math.max(0, depth + change);
    at('drop-hint').hidden = depth === 0;
  };
  window.addEventListener('dragenter', () => setHint(1));
  window.addEventListener('dragleave', () => setHint(-1));
  window.addEventListener('dragover', (event) => event.preventDefault());
  window.addEventListener('drop', (event) => {
    event.preventDefault();
    setHint(-depth);
    const files = droppedFiles(event.dataTransfer);
    open(async () => worker.request('open', { name: 'the drop', entries: await files }));
  });
}

function openDemo() {
  const url = new URL('demo/files.json', document.baseURI).href;
  return open(() => worker.request('openUrl', { url }));
}

/** Open a bundle, a scene or both. `request` asks the worker for it. */
async function open(request) {
  if (state.opening) return;
  timeLine.setPlaying(false);
  await whileOpening(async () => {
    at('problem').hidden = true;
    at('verdict').hidden = true;
    setStatus('Reading the files', true);
    const answer = await request();
    if (answer.bundle) Object.assign(state, { bundle: answer.bundle });
    if (answer.scene) Object.assign(state, { scene: answer.scene });
    if (answer.bundle || answer.scene) cache.clear();
  });
  showSources();
  if (state.bundle && state.scene && cache.results.size === 0) {
    timeLine.start(state.scene.frames.length);
    timeLine.choose(0);
  } else resume();
}

async function verify() {
  if (state.opening) return;
  timeLine.setPlaying(false);
  await whileOpening(async () => {
    at('verdict').hidden = true;
    showVerdict(at('verdict'), await worker.request('verifyGolden'));
  });
  resume();
}

async function whileOpening(work) {
  state.opening = true;
  for (const id of ['open', 'demo', 'verify', 'start-open', 'start-demo', 'start-golden']) at(id).disabled = true;
  try {
    await work();
  } catch (problem) {
    report(problem);
  } finally {
    state.opening = false;
    for (const id of ['open', 'demo', 'start-open', 'start-demo', 'start-golden']) at(id).disabled = false;
    at('verify').disabled = !state.bundle?.hasGolden;
    setStatus('');
  }
}

function showSources() {
  const { bundle, scene } = state;
  at('start').hidden = Boolean(bundle && scene);
  at('viewer').hidden = !(bundle && scene);
  if (!bundle) return;
  const weights = bundle.trained === false ? ', random weights' : '';
  const threads = `${bundle.threads} thread${bundle.threads === 1 ? '' : 's'}`;
  at('summary').textContent =
    `${bundle.preset}, ${bundle.precision}${weights} · ${scene ? `${scene.frames.length} frames · ` : ''}` +
    `onnxruntime-web ${bundle.onnxruntime}, ${threads}`;
  at('start-title').textContent = 'Now drop a scene folder';
  at('start-text').textContent =
    `The bundle ${bundle.preset} (${bundle.precision}) is loaded. It takes up to ${bundle.window} frames of history.`;
  at('start-golden').hidden = !bundle.hasGolden;
  at('start-demo').hidden = true;
}

/** Show the frame that was requested while files were opened. */
function resume() {
  if (state.wanted !== undefined) select(state.wanted);
}

/** Show a frame. While one is computed or files are opened, only the last request is kept. */
async function select(index) {
  state.wanted = index;
  if (state.isBusy || state.opening) return;
  state.isBusy = true;
  const { scene } = state;
  // While files are opened, no frame is requested: the worker would run it in the scene that follows.
  while (state.wanted !== undefined && scene === state.scene && !state.opening) {
    const wanted = state.wanted;
    state.wanted = undefined;
    try {
      await compute(wanted);
      state.index = wanted;
      draw();
    } catch (problem) {
      timeLine.setPlaying(false);
      report(problem);
    }
  }
  state.isBusy = false;
  if (state.opening) return; // `open` and `verify` go on with what is wanted
  setStatus('');
  resume();
}

async function compute(index) {
  if (cache.has(index)) {
    const pictures = cache.pictures.get(index) ?? (await worker.request('pictures', { index })).pictures;
    cache.addPictures(index, pictures);
    return;
  }
  setStatus(`Running frame ${index + 1}`, true);
  const { result, pictures } = await worker.request('frame', { index });
  cache.results.set(index, result);
  cache.addPictures(index, pictures);
}

/** Play at the speed of the recording, or as fast as frames are computed. */
async function play(isPlaying) {
  timeLine.setPlaying(isPlaying);
  if (!isPlaying || !state.scene) return;
  if (timeLine.index === timeLine.count - 1) timeLine.choose(0);
  while (timeLine.isPlaying && timeLine.index < timeLine.count - 1) {
    const start = performance.now();
    const [now, next] = [timeLine.index, timeLine.index + 1].map((index) => state.scene.frames[index].timestamp_s);
    timeLine.choose(timeLine.index + 1);
    while (state.isBusy && timeLine.isPlaying) await pause(10);
    if (timeLine.index === timeLine.count - 1) break; // playing must not go on from a frame that is chosen now
    const step_s = Math.min(LONGEST_STEP_S, Math.max(0, next - now));
    await pause(1000 * step_s - (performance.now() - start));
  }
  timeLine.setPlaying(false);
}

function draw() {
  const result = cache.results.get(state.index);
  const pictures = cache.pictures.get(state.index);
  if (at('viewer').hidden || !result || !pictures) return;
  const { bundle, scene, index } = state;
  const least = Number(at('score').value);
  at('score-value').textContent = least.toFixed(2);
  const colour = (name) => classColour(name, bundle.classes);
  const boxes = result.boxes.filter((box) => box.score >= least).map((box) => ({ ...box, colour: colour(box.class) }));
  boxes.reverse(); // the highest scores are drawn last
  const frame = scene.frames[index];
  cameraViews.layOut(frame.cameras, roomForCameras());
  cameraViews.draw(frame.cameras, pictures, boxes);
  at('map-setting').hidden = result.maps.size === 0 && result.skipped === null;
  drawBirdEyeView(at('bird-eye'), boxes, at('map').checked ? result.maps : new Map(), bundle.perception);
  const counts = new Map();
  for (const name of bundle.classes) {
    const count = boxes.filter((box) => box.class === name).length;
    if (count > 0) counts.set(name, { colour: colour(name), count });
  }
  showLegend(at('legend'), counts);
  showStages(at('stages'), result.timings_ms);
  showFrameInfo(frame, result);
  drawTimeLine();
}

/** The room that the bird's-eye view leaves, which is at least as wide as high. Undefined if the page scrolls. */
function roomForCameras() {
  if (window.matchMedia(NARROW).matches) return undefined;
  const { width, height } = at('views').getBoundingClientRect();
  return { width: width - Math.min(height - LEGEND_PX, 0.48 * width) - GAP_PX, height };
}

function drawTimeLine() {
  const { frames } = state.scene;
  const elapsed_s = frames[state.index].timestamp_s - frames[0].timestamp_s;
  const text = `${state.index + 1} / ${frames.length}   ${elapsed_s >= 0 ? '+' : '−'}${Math.abs(elapsed_s).toFixed(2)} s`;
  timeLine.draw(text, (index) => {
    if (!cache.has(index)) return 'waiting';
    return cache.results.get(index).skipped === null ? 'computed' : 'skipped';
  });
}

function showFrameInfo(frame, { history, skipped, boxes, dropped }) {
  const parts = [frame.scene, frame.token && `frame ${frame.token}`].filter(Boolean);
  if (skipped !== null) parts.push(`skipped: ${skipped}`);
  else {
    const ages = history.ages_s.map((age) => age.toFixed(1)).join(', ');
    parts.push(ages ? `history of ${ages} s` : 'no history');
    if (history.reset_reason) parts.push(`reset: ${history.reset_reason}`);
    if (dropped.queries + dropped.map_cells > 0)
      parts.push('degraded: the network returned numbers that are not finite');
    parts.push(`${boxes.length} detections`);
  }
  const place = at('frame-info');
  const first = document.createElement('strong');
  first.textContent = parts[0] ?? '';
  place.replaceChildren(
    first,
    parts
      .slice(1)
      .map((part) => ` · ${part}`)
      .join(''),
  );
  place.title = parts.join(' · ');
}

function report(problem) {
  const isProblem = typeof problem?.expected === 'string';
  const unexpected = {
    part: 'page',
    where: 'the page',
    expected: 'a result',
    found: String(problem?.message ?? problem),
    remedy: 'Reload the page.',
  };
  showProblem(at('problem'), isProblem ? problem : unexpected);
}

/** Save the results of the frames that were computed, in the order of the scene. */
function saveResults() {
  const computed = [...cache.results].sort(([one], [other]) => one - other);
  const lines = computed.map(
    ([index, result]) => `${JSON.stringify(frameResult(state.scene.frames[index], result))}\n`,
  );
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob(lines, { type: 'application/jsonl' }));
  link.download = 'results.jsonl';
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function setStatus(text, isBusy = false) {
  at('status').textContent = isBusy ? `${text} …` : text;
  at('status').classList.toggle('busy', isBusy);
}

function pause(milliseconds) {
  return new Promise((resolve) => setTimeout(resolve, Math.max(0, milliseconds)));
}
