// The golden example of a bundle: three frames, and the values that every consumer must compute from them.

import { readHashed } from './bundle.js';
import { BundleError, shown } from './errors.js';
import { Fields } from './fields.js';
import { MANIFEST_NAME } from './manifest.js';
import { readImages, readScene } from './scene.js';
import { parseStrictJson } from './strict-json.js';

const REMEDY = 'The bundle is damaged: copy the whole folder, or export again.';
const NO_GOLDEN = 'Export the bundle again with this version of the toolkit.';
const MAX_DIFFERENCES = 100; // in a report
const YAW_COLUMN = 6; // of a box

/**
 * Read the golden example of a bundle, and check the hashes of its files.
 * @param {{manifest: object, folder: import('./folder.js').Folder}} bundle
 * @returns {Promise<{expected: object, results: object[], scene: import('./folder.js').Folder}>}
 */
export async function readGolden({ manifest, folder }) {
  const fields = new Fields(manifest, MANIFEST_NAME, '', BundleError, NO_GOLDEN);
  if (!fields.has('golden')) fields.refuse('golden', 'a golden example', undefined);
  const golden = fields.object('golden');
  const [expectedPath, resultsPath, scenePath] = ['expected', 'results', 'scene'].map((name) => golden.text(name));
  const hashes = golden.object('sha256');
  const unlisted = folder.paths.find((path) => path.startsWith('golden/') && !hashes.has(path));
  if (unlisted !== undefined)
    throw new BundleError(unlisted, `only files that ${MANIFEST_NAME} lists`, 'another one', REMEDY);
  const contents = new Map();
  for (const path of hashes.names) contents.set(path, await readListed(folder, path, hashes.text(path)));
  for (const path of [expectedPath, resultsPath]) {
    if (!contents.has(path)) hashes.refuse(path, 'a hash', undefined);
  }
  const lines = new TextDecoder().decode(contents.get(resultsPath)).split('\n').filter(Boolean);
  return {
    expected: readExpected(contents.get(expectedPath), expectedPath),
    results: lines.map((line) => parseStrictJson(new TextEncoder().encode(line), resultsPath, BundleError)),
    scene: folder.sub(scenePath),
  };
}

/**
 * Run the golden example from a cold start, and compare every tensor and every box.
 * @param {import('./pipeline.js').Pipeline} pipeline
 * @param {object} golden of `readGolden`
 * @param {object} jpeg see `decodeImage`
 * @param {(done: number, all: number) => void} onProgress called before each frame
 * @returns {Promise<{passed: boolean, frames: number, tensors: number, values: number, largestShare: number,
 *   differences: {frame: string, tensor: string, index: string, expected: string, found: string}[]}>}
 *   largestShare: the largest error as a share of its tolerance
 */
export async function verify(pipeline, golden, jpeg, onProgress = () => {}) {
  const scene = await readScene(golden.scene, pipeline.manifest.num_cameras);
  const { expected, results } = golden;
  if (scene.frames.length !== expected.frames.length || results.length !== expected.frames.length) {
    const found = `${scene.frames.length} frames, ${expected.frames.length} of expected values, ${results.length} results`;
    throw new BundleError('golden', 'as many results as frames', found, REMEDY);
  }
  const report = new Report();
  const stream = pipeline.stream({ maps: true });
  for (const [index, frame] of scene.frames.entries()) {
    onProgress(index, scene.frames.length);
    const tensors = new Map();
    const observe = (graph, values) => {
      for (const [name, value] of Object.entries(values)) tensors.set(`${graph}.${name}`, value);
    };
    const result = await stream.step(frame, await readImages(scene, frame, jpeg), observe);
    report.frame = frame.token;
    report.compareTensors(expected.frames[index].tensors, tensors);
    report.compareResult(results[index], result, expected.tolerance);
  }
  return report.summary(scene.frames.length);
}

async function readListed(folder, path, digest) {
  if (!folder.has(path)) throw new BundleError(path, `a file, as ${MANIFEST_NAME} says`, 'no such file', REMEDY);
  return readHashed(folder, path, digest, REMEDY);
}

function readExpected(bytes, where) {
  const values = parseStrictJson(bytes, where, BundleError);
  const fields = new Fields(values, where, '', BundleError, REMEDY);
  fields.oneOf('schema_version', [1]);
  const tolerance = fields.object('tolerance');
  for (const name of ['box', 'score']) if (tolerance.get(name) !== null) tolerance.number(name);
  fields.list('frames', 1).forEach((frame, index) => {
    const tensors = new Fields(frame, where, `frames.${index}`, BundleError, REMEDY).object('tensors');
    for (const name of tensors.names) {
      const tensor = tensors.object(name);
      tensor.list('shape');
      tensor.list('values', 1);
      tensor.integer('step', 1, 2 ** 31);
      tensor.oneOf('compare', ['each', 'rms']);
      tensor.number('tolerance');
    }
  });
  return values;
}

/** Collects the differences of a verification. */
class Report {
  frame = '';
  differences = [];
  tensors = 0;
  values = 0;
  largestShare = 0;

  /** Compare all tensors. Those of the graphs and those with expected values must be the same. */
  compareTensors(expected, tensors) {
    for (const [name, values] of Object.entries(expected)) this.compareTensor(name, values, tensors.get(name));
    for (const name of tensors.keys()) {
      if (!Object.hasOwn(expected, name)) this.add(name, '', 'no such tensor', 'one without expected values');
    }
  }

  compareTensor(name, { shape, step, compare, tolerance, values }, found) {
    this.tensors += 1;
    const size = shape.reduce((product, length) => product * length, 1);
    const data = found?.data ?? found;
    if (data?.length !== size) {
      this.add(name, '', `${size} numbers, shape [${shape}]`, data === undefined ? 'no such tensor' : `${data.length}`);
      return;
    }
    if (values.length !== Math.ceil(size / step)) {
      this.add(name, '', `${Math.ceil(size / step)} expected values`, `${values.length}`);
      return;
    }
    const isYaw = (i) => name === 'decoder.boxes' && (i * step) % shape[1] === YAW_COLUMN;
    const errorOf = (value, i) => (isYaw(i) ? turnBetween(value, data[i * step]) : Math.abs(data[i * step] - value));
    const compared = [...values.entries()]
      .filter(([, value]) => value !== null)
      .map(([i, value]) => ({ i, value, error: errorOf(value, i) }));
    this.values += compared.length;
    if (compare === 'rms') {
      const rms = Math.sqrt(compared.reduce((sum, { error }) => sum + error * error, 0) / Math.max(1, compared.length));
      if (this.isWithin(rms, tolerance)) return;
      this.add(name, '', `values with an RMS error of at most ${tolerance.toPrecision(2)}`, `${rms.toPrecision(2)}`);
      return;
    }
    for (const { i, value, error } of compared) {
      if (this.isWithin(error, tolerance)) continue;
      this.add(name, indices(i * step, shape), `${value} ± ${tolerance.toPrecision(2)}`, `${Number(data[i * step])}`);
    }
  }

  compareResult(line, result, tolerance) {
    const equal = (name, expected, found) => {
      if (expected !== found) this.add(name, '', shown(expected), shown(found));
    };
    equal('history.frames', line.history.frames, result.history.frames);
    equal('history.reset_reason', line.history.reset_reason, result.history.reset_reason);
    equal('skipped', line.skipped, result.skipped);
    equal('number of boxes', line.boxes.length, result.boxes.length);
    if (tolerance.box === null || tolerance.score === null) return;
    const lowest = Math.min(...line.boxes.map((box) => box.score));
    line.boxes.forEach((box, index) => {
      const nearest = Math.min(...result.boxes.map((other) => share(box, other, tolerance)));
      this.values += 1;
      // At the end of a full list, equal scores may be in or out.
      if (nearest <= 1) this.largestShare = Math.max(this.largestShare, nearest);
      else if (box.score > lowest + tolerance.score) {
        const nearby = Number.isFinite(nearest)
          ? `the nearest is off by ${nearest.toPrecision(2)} tolerances`
          : 'none of its class';
        this.add('boxes', `${index}`, `a ${box.class}, score ${box.score}, at ${box.center_m}`, nearby);
      }
    });
  }

  /** Whether an error is within its tolerance. NaN is not. */
  isWithin(error, tolerance) {
    if (!(error <= tolerance)) return false;
    if (tolerance > 0) this.largestShare = Math.max(this.largestShare, error / tolerance);
    return true;
  }

  add(tensor, index, expected, found) {
    this.differences.push({ frame: this.frame, tensor, index, expected, found });
  }

  summary(frames) {
    const { differences, tensors, values, largestShare } = this;
    const passed = differences.length === 0;
    return {
      passed,
      frames,
      tensors,
      values,
      largestShare,
      count: differences.length,
      differences: differences.slice(0, MAX_DIFFERENCES),
    };
  }
}

/** The largest difference of two boxes, as a share of its tolerance; infinite for two classes. */
function share(line, { class: name, score, box }, tolerance) {
  if (line.class !== name) return Infinity;
  const numbers = [...line.center_m, ...line.size_wlh_m, ...line.velocity_m_s];
  const found = [...box.slice(0, 6), ...box.slice(7, 9)];
  const errors = numbers.map((value, k) => Math.abs(value - found[k]));
  const largest = Math.max(...errors, turnBetween(line.yaw_rad, box[YAW_COLUMN]));
  return Math.max(largest / tolerance.box, Math.abs(line.score - score) / tolerance.score);
}

/** The angle between two yaws [rad], modulo a full turn. */
function turnBetween(one, other) {
  const turn = Math.abs(one - other) % (2 * Math.PI);
  return Math.min(turn, 2 * Math.PI - turn);
}

/** The index of each axis of the element with a row-major index. */
function indices(flat, shape) {
  const result = [];
  for (let rest = flat, axis = shape.length - 1; axis >= 0; axis -= 1) {
    result.unshift(rest % shape[axis]);
    rest = Math.floor(rest / shape[axis]);
  }
  return result.join(', ');
}
