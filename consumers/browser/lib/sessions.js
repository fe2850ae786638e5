// The graphs of a bundle in onnxruntime-web. The library itself is passed in, because the page and Node load it in
// different ways.

import { BundleError } from './errors.js';
import { numElements } from './manifest.js';

/**
 * Open a session for each graph.
 * @param {object} ort onnxruntime-web
 * @param {{manifest: object, graphs: Map<string, Uint8Array>}} bundle
 * @param {(graph: string) => void} onProgress called before each graph is loaded
 * @returns {Promise<Map<string, Graph>>} by name
 */
export async function openGraphs(ort, { manifest, graphs }, onProgress = () => {}) {
  const opened = new Map();
  try {
    for (const [name, bytes] of graphs) {
      onProgress(name);
      opened.set(name, await openGraph(ort, name, bytes, manifest.graphs[name]));
    }
  } catch (error) {
    for (const graph of opened.values()) await graph.release();
    throw error;
  }
  return opened;
}

async function openGraph(ort, name, bytes, spec) {
  let session;
  try {
    session = await ort.InferenceSession.create(bytes, { executionProviders: ['wasm'], graphOptimizationLevel: 'all' });
  } catch (error) {
    const remedy = 'Export for another opset, or in the grid-sample form; see docs/engines.md.';
    throw new BundleError(spec.file, 'a graph that onnxruntime-web can load', error?.message ?? String(error), remedy);
  }
  try {
    checkTensors(spec.file, 'inputs', session.inputMetadata, spec.inputs);
    checkTensors(spec.file, 'outputs', session.outputMetadata, spec.outputs);
  } catch (error) {
    await session.release();
    throw error;
  }
  return new Graph(ort, session, spec);
}

/** Compare the tensors of a graph with those of the manifest. */
function checkTensors(file, side, found, specs) {
  const describe = (name, shape, dtype) => `${name} ${dtype}[${shape.join(',')}]`;
  const inGraph = found.map((tensor) => describe(tensor.name, tensor.shape ?? [], tensor.type)).sort();
  const inManifest = specs.map((spec) => describe(spec.name, spec.shape, spec.dtype)).sort();
  const difference = inManifest.findIndex((tensor, index) => tensor !== inGraph[index]);
  if (difference >= 0 || inGraph.length !== inManifest.length) {
    const index = difference >= 0 ? difference : inManifest.length;
    const [expected, got] = [inManifest[index] ?? 'no more', inGraph[index] ?? 'no more'];
    throw new BundleError(`${file}, ${side}`, `${expected}, as in the manifest`, got, 'Export the bundle again.');
  }
}

/** A graph that is run on arrays and tensors by name. */
export class Graph {
  constructor(ort, session, spec) {
    this.ort = ort;
    this.session = session;
    this.spec = spec;
  }

  /**
   * @param {Record<string, object>} values typed arrays or tensors by name; further names are ignored
   * @returns {Promise<Record<string, object>>} tensors by name
   */
  async run(values) {
    const feeds = {};
    for (const { name, dtype, shape } of this.spec.inputs) {
      const value = values[name];
      feeds[name] = ArrayBuffer.isView(value) ? new this.ort.Tensor(dtype, value, shape) : value;
    }
    return this.session.run(feeds);
  }

  /** Free the memory of the graph. */
  async release() {
    await this.session.release();
  }
}

/**
 * A backbone that takes b of the N cameras at a time: it runs N / b times, and its outputs are concatenated. A group of
 * cameras without images is not run, and its features are zeros: the other graphs mask them.
 */
export class CameraGroups {
  constructor(graph, numCameras) {
    this.graph = graph;
    this.numCameras = numCameras;
  }

  async release() {
    await this.graph.release();
  }

  async run({ images, camera_valid: valid }) {
    const { ort, spec } = this.graph;
    const size = spec.inputs[0].shape[0];
    const pixels = images.length / this.numCameras;
    const outputs = {};
    for (const { name, shape } of spec.outputs) {
      const elements = (numElements({ shape }) / shape[0]) * this.numCameras;
      outputs[name] = new ort.Tensor('float32', new Float32Array(elements), [this.numCameras, ...shape.slice(1)]);
    }
    for (let first = 0; first < this.numCameras; first += size) {
      if (!valid.subarray(first, first + size).some(Boolean)) continue;
      const features = await this.graph.run({ images: images.slice(first * pixels, (first + size) * pixels) });
      for (const [name, tensor] of Object.entries(features)) {
        outputs[name].data.set(tensor.data, (first * tensor.data.length) / size);
      }
    }
    return outputs;
  }
}
