// The worker of the page: reads files, decodes images and runs the graphs, so that the page stays responsive.

import jpegFactory from '@cornerstonejs/codec-libjpeg-turbo-8bit/decodewasmjs';
import jpegWasmUrl from '@cornerstonejs/codec-libjpeg-turbo-8bit/decodewasm?url';
import * as ort from 'onnxruntime-web/wasm';
import ortModuleUrl from 'onnxruntime-web/ort-wasm-simd-threaded.mjs?url';
import ortWasmUrl from 'onnxruntime-web/ort-wasm-simd-threaded.wasm?url';

import { readBundle } from '../lib/bundle.js';
import { BundleError, ConsumerError, SceneError } from '../lib/errors.js';
import { Folder } from '../lib/folder.js';
import { readGolden, verify } from '../lib/golden.js';
import { loadJpegDecoder } from '../lib/image-files.js';
import { Pipeline } from '../lib/pipeline.js';
import { Replay } from '../lib/replay.js';
import { readImages, readScene } from '../lib/scene.js';
import { findSources } from '../lib/sources.js';

const MAX_THREADS = 8;
const PICTURE_WIDTH_PX = 960;

const state = { bundle: undefined, pipeline: undefined, scene: undefined, replay: undefined, jpeg: undefined };

const numThreads = self.crossOriginIsolated ? Math.min(MAX_THREADS, navigator.hardwareConcurrency || 1) : 1;
ort.env.wasm.numThreads = numThreads;
ort.env.wasm.wasmPaths = { mjs: absolute(ortModuleUrl), wasm: absolute(ortWasmUrl) };
ort.env.logLevel = 'error';

const ACTIONS = { open, openUrl, openGolden, frame, pictures, verifyGolden };

// One request at a time, in their order.
let queue = Promise.resolve();
self.addEventListener('message', ({ data: { id, action, values } }) => {
  queue = queue.then(async () => {
    try {
      const { answer, transfer } = await ACTIONS[action](values);
      self.postMessage({ id, answer }, transfer ?? []);
    } catch (error) {
      self.postMessage({ id, problem: describe(error) });
    }
  });
});

/** Open the bundle, the scene folder or both that are among the files that the user gave. */
async function open({ name, entries }) {
  return openFolder(Folder.ofFiles(name, entries));
}

/** Open the files that a list at `url` names. Their paths are relative to it. */
async function openUrl({ url }) {
  const list = await fetchFrom(url, 'json');
  if (!Array.isArray(list)) throw new ConsumerError(url, 'a list of files', 'something else', 'Run `npm run demo`.');
  const files = list.map(({ path, size }) => {
    const file = new URL(path.split('/').map(encodeURIComponent).join('/'), url);
    return [path, { size, read: async () => new Uint8Array(await fetchFrom(file, 'arrayBuffer')) }];
  });
  return openFolder(new Folder('demo', new Map(files)));
}

/** Open the golden scene of the open bundle. */
async function openGolden() {
  const { bundle, pipeline } = state;
  Object.assign(state, await loadScene((await readGolden(bundle)).scene, bundle, pipeline));
  return { answer: { scene: describeScene() } };
}

/** Open what is in a folder. If a part of it cannot be used, everything stays as it was. */
async function openFolder(folder) {
  const given = findSources(folder);
  if (!given.bundle && !state.bundle) {
    const remedy = 'Open the bundle first, or both together.';
    throw new ConsumerError(
      given.scene.name || 'the files',
      'a bundle before its scene',
      'a scene folder alone',
      remedy,
    );
  }
  const old = state.pipeline;
  const opened = given.bundle ? await loadBundle(given.bundle) : { bundle: state.bundle, pipeline: old };
  const sceneFolder = given.scene ?? state.scene?.folder; // an open scene is checked against the new bundle
  let scene;
  try {
    scene = sceneFolder && (await loadScene(sceneFolder, opened.bundle, opened.pipeline));
  } catch (error) {
    if (opened.pipeline !== old) await opened.pipeline.release();
    throw error;
  }
  Object.assign(state, opened, scene);
  if (old && old !== opened.pipeline) await old.release();
  return { answer: { ...(given.bundle && { bundle: describeBundle() }), ...(scene && { scene: describeScene() }) } };
}

async function loadBundle(folder) {
  progress('Checking the bundle');
  const bundle = await readBundle(folder);
  const pipeline = await Pipeline.load(ort, bundle, (graph) => progress(`Loading the ${graph}`));
  bundle.graphs.clear(); // the sessions have copies
  return { bundle, pipeline };
}

async function loadScene(folder, bundle, pipeline) {
  progress('Checking the scene');
  const scene = await readScene(folder, bundle.manifest.num_cameras);
  const jpeg =
    state.jpeg ??
    (await loadJpegDecoder(jpegFactory, new Uint8Array(await fetchFrom(absolute(jpegWasmUrl), 'arrayBuffer'))));
  return { scene, jpeg, replay: new Replay(pipeline, scene, jpeg) };
}

/** Run a frame. Answers with its result, and the pictures of its cameras. */
async function frame({ index }) {
  const { result, images } = await state.replay.frame(index, (done, all) => {
    if (all > 1) progress(`Running frame ${done + 1} of ${all} for the history`);
  });
  return withPictures({ result }, images);
}

/** Read the pictures of a frame again. */
async function pictures({ index }) {
  return withPictures({}, await readImages(state.scene, state.scene.frames[index], state.jpeg));
}

async function verifyGolden() {
  const jpeg = state.jpeg ?? {
    decode: () => {
      throw new Error('golden images are PNG files');
    },
  };
  const report = await verify(state.pipeline, await readGolden(state.bundle), jpeg, (done, all) => {
    progress(`Verifying frame ${done + 1} of ${all}`);
  });
  return { answer: report };
}

async function withPictures(answer, images) {
  const bitmaps = new Map();
  for (const [name, image] of images) if (image !== null) bitmaps.set(name, await toBitmap(image));
  return { answer: { ...answer, pictures: bitmaps }, transfer: [...bitmaps.values()] };
}

async function toBitmap({ width, height, data }) {
  const pixels = new ImageData(width, height);
  for (let from = 0, to = 0; from < data.length; from += 3, to += 4) {
    pixels.data[to] = data[from + 2];
    pixels.data[to + 1] = data[from + 1];
    pixels.data[to + 2] = data[from];
    pixels.data[to + 3] = 255;
  }
  const resizeWidth = Math.min(width, PICTURE_WIDTH_PX);
  const resizeHeight = Math.max(1, Math.round((height * resizeWidth) / width));
  return createImageBitmap(pixels, { resizeWidth, resizeHeight, resizeQuality: 'medium' });
}

function describeBundle() {
  const { manifest, folder } = state.bundle;
  return {
    name: folder.name,
    preset: manifest.preset,
    precision: manifest.precision,
    trained: manifest.weights?.trained ?? null,
    window: manifest.window.num_frames,
    classes: manifest.classes,
    perception: manifest.perception,
    hasGolden: Boolean(manifest.golden),
    threads: numThreads,
    onnxruntime: ort.env.versions.web ?? ort.env.versions.common,
  };
}

function describeScene() {
  const { folder, frames } = state.scene;
  return { name: folder.name, frames };
}

async function fetchFrom(url, kind) {
  let response;
  try {
    response = await fetch(url);
  } catch (error) {
    throw new ConsumerError(String(url), 'a file of the host', error.message, 'Check the connection to the host.');
  }
  if (!response.ok) {
    const remedy = 'Run `npm run demo` before `npm run build`, or copy the whole folder to the host.';
    throw new ConsumerError(String(url), 'a file of the host', `status ${response.status}`, remedy);
  }
  try {
    return await response[kind]();
  } catch (error) {
    throw new ConsumerError(String(url), 'a complete file', error.message, 'Copy the whole folder to the host.');
  }
}

function progress(text) {
  self.postMessage({ progress: text });
}

function describe(error) {
  if (error instanceof ConsumerError) {
    const part = error instanceof BundleError ? 'bundle' : error instanceof SceneError ? 'scene' : 'files';
    return { part, where: error.where, expected: error.expected, found: error.found, remedy: error.remedy };
  }
  const remedy = 'Reload the page. If it happens again, report it with the text in the console.';
  console.error(error);
  return { part: 'page', where: 'the page', expected: 'a result', found: error?.message ?? String(error), remedy };
}

function absolute(url) {
  return new URL(url, self.location.href).href;
}
