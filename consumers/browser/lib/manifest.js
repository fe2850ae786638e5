// The manifest of a bundle, `manifest.json`: its seal, its fields, and the rules that this consumer implements.

import { sha256 } from '@noble/hashes/sha2.js';
import { bytesToHex } from '@noble/hashes/utils.js';

import { BundleError } from './errors.js';
import { Fields } from './fields.js';
import { parseStrictJson } from './strict-json.js';

export const MANIFEST_NAME = 'manifest.json';
export const NEWEST_SCHEMA = 5;
const MAX_MANIFEST_BYTES = 2 ** 24;
const MAX_TENSOR_ELEMENTS = 2 ** 29;
const COPY_AGAIN = 'The file is damaged or was edited: copy the whole folder, or export again.';
const EXPORT_AGAIN = 'Export the bundle again.';

const GRAPHS = ['projector', 'backbone', 'lifter', 'decoder', 'segmenter'];
const NEEDS = { projector: ['lifter'], lifter: ['projector'], segmenter: ['lifter'] };

// The rules that this consumer implements. Manifests since schema 5 name them; before that there was no other rule.
const RULES = {
  preprocessing: {
    colour_order: ['bgr'],
    scaling: ['cover'],
    size_rounding: ['half to even'],
    resize_shrinking: ['area', 'area by halvings'],
    resize_enlarging: ['linear'],
    crop: ['centre columns, bottom rows'],
    crop_rounding: ['down'],
    pixel_centres: ['at halves'],
  },
  window: {
    slots: ['newest first'],
    speed: ['3D distance / time step'],
    turn: ['3D rotation angle / time step'],
    above_largest: ['reset'],
    new_scene: ['reset'],
    time_stamp_not_later: ['refuse'],
    frame_without_images: ['skip'],
  },
  selection: {
    score: ['sigmoid'],
    score_dtype: ['float32'],
    order: ['score descending'],
    ties: ['query, class'],
    largest_count: [500],
    smallest_score: [null],
    suppression: ['none'],
    not_finite: ['drop query'],
  },
  axes: {
    ego: [['forward', 'left', 'up']],
    camera: [['right', 'down', 'forward']],
    image: [['right', 'down']],
  },
  boxes: {
    columns: [['x_m', 'y_m', 'z_m', 'w_m', 'l_m', 'h_m', 'yaw_rad', 'vx_m_s', 'vy_m_s']],
    frame: ['ego'],
    position: ['centre'],
    length: ['along heading'],
    yaw: ['from x, counter-clockwise about z'],
    velocity: ['over ground'],
  },
  maps: {
    axes: [['x', 'y']],
    cell_centre: ['lower + (index + 0.5) * (upper - lower) / size'],
    probability: ['sigmoid'],
    not_finite: [0],
  },
};

/**
 * Read and check the bytes of a manifest.
 * @returns {object} the manifest; its fields are those of the file
 */
export function readManifest(bytes, where = MANIFEST_NAME) {
  if (bytes.length > MAX_MANIFEST_BYTES) {
    throw new BundleError(where, `at most ${MAX_MANIFEST_BYTES} bytes`, `${bytes.length} bytes`, EXPORT_AGAIN);
  }
  const manifest = parseStrictJson(bytes, where, BundleError);
  const fields = new Fields(manifest, where, '', BundleError, EXPORT_AGAIN);
  checkVersion(fields);
  if (manifest.schema_version === 1) checkSchema1(fields);
  else checkSeal(bytes, where);
  checkModel(fields);
  checkRules(fields);
  checkGraphs(fields);
  checkParity(fields);
  return manifest;
}

/** The decoder's input name for the cached value `name` of the frame `slot` steps ago. */
export function slotName(slot, name) {
  return `slot${slot}.${name}`;
}

/** The number of elements of a tensor of the manifest. */
export function numElements(spec) {
  return spec.shape.reduce((product, size) => product * size, 1);
}

function checkVersion(fields) {
  const version = fields.integer('schema_version', 1, Number.MAX_SAFE_INTEGER);
  if (version > NEWEST_SCHEMA) {
    const remedy = 'The bundle is newer than this page: update the page, or export with an older toolkit.';
    throw new BundleError(`${fields.where}, field schema_version`, `at most ${NEWEST_SCHEMA}`, `${version}`, remedy);
  }
}

/** The last field, `sha256`, is the hash of all lines before it. */
function checkSeal(bytes, where) {
  const text = new TextDecoder().decode(bytes);
  const end = text.lastIndexOf(',\n') + 2;
  const seal = /^[ \t]*"sha256": *"([0-9a-f]{64})"\n\}\n?$/.exec(text.slice(end));
  const field = `${where}, field sha256`;
  if (seal === null) {
    throw new BundleError(field, '64 hexadecimal digits as the last field', 'none', COPY_AGAIN);
  }
  // The text is UTF-8 without a byte order mark, so encoding it again gives the bytes of the file.
  const digest = bytesToHex(sha256(new TextEncoder().encode(text.slice(0, end))));
  if (digest !== seal[1]) {
    const expected = `${digest.slice(0, 12)}…, the hash of the lines before it`;
    throw new BundleError(field, expected, `${seal[1].slice(0, 12)}…`, COPY_AGAIN);
  }
}

/** Schema 1 has no seal. A newer manifest could be edited, and called schema 1 to avoid the seal. */
function checkSchema1(fields) {
  const later = ['sha256', 'dcn', 'attention', 'quantization', 'golden', 'selection', 'boxes', 'axes', 'maps'];
  const isLater = (holder, names) => names.find((name) => holder.names.includes(name));
  const found =
    isLater(fields, later) ??
    isLater(fields.object('window'), ['largest_turn_rad_s']) ??
    isLater(fields.object('weights'), ['checkpoint', 'anchors']) ??
    fields.object('graphs').names.find((name) => fields.object('graphs').object(name).names.includes('opsets'));
  if (found !== undefined) {
    throw new BundleError(`${fields.where}, field ${found}`, 'only in later schemas', 'it in schema 1', COPY_AGAIN);
  }
}

function checkModel(fields) {
  fields.text('preset');
  fields.nameList('classes');
  fields.nameList('map_classes');
  fields.nameList('memory');
  fields.integer('num_cameras', 1, 256);
  const preprocessing = fields.object('preprocessing');
  preprocessing.integer('width_px', 1, 2 ** 16);
  preprocessing.integer('height_px', 1, 2 ** 16);
  const window = fields.object('window');
  window.integer('num_frames', 1, 256);
  for (const name of ['largest_time_delta_s', 'largest_speed_m_s']) window.number(name, { above: 0 });
  if (window.has('largest_turn_rad_s')) window.number('largest_turn_rad_s', { above: 0 });
  const perception = fields.object('perception');
  for (const name of ['size', 'lower_m', 'upper_m']) perception.numbers(name, 3);
}

function checkRules(fields) {
  for (const [part, rules] of Object.entries(RULES)) {
    if (!fields.has(part)) continue;
    const present = fields.object(part);
    for (const [name, choices] of Object.entries(rules)) {
      if (present.has(name)) present.oneOf(name, choices);
    }
  }
  for (const name of ['colour_order', 'resize_shrinking', 'resize_enlarging', 'crop']) {
    fields.object('preprocessing').oneOf(name, RULES.preprocessing[name]);
  }
}

function checkGraphs(fields) {
  const graphs = fields.object('graphs');
  const needed = new Set(['backbone', 'decoder']);
  for (const name of graphs.names) {
    if (!GRAPHS.includes(name)) graphs.refuse(name, `one of ${GRAPHS.join(', ')}`, name);
    checkGraph(graphs.object(name), name);
    (NEEDS[name] ?? []).forEach((other) => needed.add(other));
  }
  for (const name of needed) {
    if (!graphs.has(name)) graphs.refuse(name, 'an entry, which other graphs need', undefined);
  }
  checkConsistency(fields);
}

function checkGraph(graph, name) {
  graph.oneOf('file', [`${name}.onnx`]);
  graph.check('sha256', '64 hexadecimal digits', (value) => /^[0-9a-f]{64}$/.test(value));
  for (const side of ['inputs', 'outputs']) {
    graph.list(side, 1).forEach((_, index) => {
      const tensor = new Fields(
        graph.values[side][index],
        graph.where,
        `${graph.place}.${side}.${index}`,
        BundleError,
        EXPORT_AGAIN,
      );
      tensor.name('name');
      tensor.oneOf('dtype', ['float32', 'uint8', 'bool']);
      const isSize = (size) => Number.isInteger(size) && size > 0;
      tensor.check('shape', 'a list of at most 8 positive integers', (shape) => {
        return (
          Array.isArray(shape) && shape.length <= 8 && shape.every(isSize) && product(shape) <= MAX_TENSOR_ELEMENTS
        );
      });
    });
  }
}

/** Compare the sizes in the manifest with the tensors of its graphs. */
function checkConsistency(fields) {
  const { graphs, preprocessing, memory, window } = fields.values;
  const images = graphs.backbone.inputs.find((spec) => spec.name === 'images');
  if (images === undefined) fields.refuse('graphs.backbone.inputs', 'an input images', undefined);
  const [perRun, height, width] = images.shape;
  const equal = (field, expected, found) => {
    if (expected !== found) fields.refuse(field, `${expected}, as in its graphs`, found);
  };
  equal('preprocessing.width_px', width, preprocessing.width_px);
  equal('preprocessing.height_px', height, preprocessing.height_px);
  if (fields.values.num_cameras % perRun !== 0) {
    fields.refuse('num_cameras', `a multiple of ${perRun}, as in its graphs`, fields.values.num_cameras);
  }
  const logits = graphs.decoder.outputs.find((spec) => spec.name === 'class_logits');
  equal('classes', logits?.shape[1], fields.values.classes.length);
  const decoderInputs = new Map(graphs.decoder.inputs.map((spec) => [spec.name, spec]));
  equal('window.num_frames', decoderInputs.get('frame_valid')?.shape[0], window.num_frames);
  const available = new Set(
    ['backbone', 'lifter'].flatMap((name) => (graphs[name]?.outputs ?? []).map((spec) => spec.name)),
  );
  for (const name of memory) {
    if (!available.has(name) || !decoderInputs.has(slotName(0, name))) {
      fields.refuse('memory', 'outputs of the backbone or the lifter that the decoder takes', name);
    }
  }
}

function checkParity(fields) {
  if (fields.get('parity')?.passed !== true) {
    const found = fields.has('parity') ? 'a failed one' : 'no report';
    throw new BundleError(`${fields.where}, field parity`, 'a passed parity report', found, EXPORT_AGAIN);
  }
}

function product(shape) {
  return shape.reduce((result, size) => result * size, 1);
}
