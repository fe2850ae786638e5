// A loaded bundle, and streams of frames through it. The steps are those of docs/frame-steps.md.

import { selectDetections, mapProbabilities } from './detections.js';
import { after, decoderInputs, pastFrame, resetReason } from './history.js';
import { numElements, slotName } from './manifest.js';
import { prepare } from './preprocessing.js';
import { CameraGroups, openGraphs } from './sessions.js';
import { checkFrame } from './validation.js';

export class Pipeline {
  constructor(manifest, graphs) {
    this.manifest = manifest;
    this.graphs = graphs;
    this.emptyMemory = emptyMemory(manifest);
  }

  /** Load a bundle that `readBundle` has checked. See `openGraphs` for the arguments. */
  static async load(ort, bundle, onProgress) {
    const graphs = await openGraphs(ort, bundle, onProgress);
    const { manifest } = bundle;
    const backbone = graphs.get('backbone');
    if (backbone.spec.inputs[0].shape[0] !== manifest.num_cameras) {
      graphs.set('backbone', new CameraGroups(backbone, manifest.num_cameras));
    }
    return new Pipeline(manifest, graphs);
  }

  /** Free the memory of the graphs. Streams of this pipeline end. */
  async release() {
    for (const graph of this.graphs.values()) await graph.release();
  }

  /** @param {{maps?: boolean}} options maps: also compute the probabilities of the map classes */
  stream({ maps = false } = {}) {
    return new Stream(this, maps && this.graphs.has('segmenter'));
  }
}

/**
 * The frames of one vehicle, in time order, and the history of cached values. Changes only when a step has succeeded.
 */
export class Stream {
  constructor(pipeline, maps) {
    this.pipeline = pipeline;
    this.maps = maps;
    this.history = [];
    this.tables = undefined;
  }

  /**
   * Process the next frame.
   * @param {import('./scene.js').Frame} frame
   * @param {Map<string, object | null>} images by camera, BGR; null if lost
   * @param {(name: string, tensors: Record<string, object>) => void} observe gets the host inputs as `inputs`, the
   *   outputs of each graph, and map probabilities as `maps`
   */
  async step(frame, images, observe = () => {}) {
    const { manifest, graphs } = this.pipeline;
    const { num_frames: numFrames } = manifest.window;
    const clock = new Clock();
    checkFrame(frame, manifest.num_cameras);
    const reset = resetReason(this.history[0], frame, manifest.window);
    if ([...frame.cameras.keys()].every((name) => images.get(name) === null)) {
      return skippedResult('every camera is lost');
    }
    const history = reset === null ? this.history : [];
    const inputs = clock.measure('preprocess', () => prepare(frame, images, manifest));
    const features = await this.encode(inputs, clock, observe);
    const memory = new Map(manifest.memory.map((name) => [name, features[name]]));
    const now = pastFrame(frame, inputs, memory);
    const window = [now, ...history.slice(0, numFrames - 1)];
    const windowInputs = decoderInputs(window, numFrames, manifest.num_cameras);
    observe('inputs', { ...inputs, ...this.ofDecoder(windowInputs) });
    const outputs = await clock.measure('decoder', () =>
      graphs.get('decoder').run({ ...windowInputs, ...this.slots(window) }),
    );
    observe('decoder', outputs);
    const maps = this.maps ? await this.segment(features, clock, observe) : { maps: new Map(), droppedCells: 0 };
    if (this.maps) observe('maps', Object.fromEntries(maps.maps));
    const { boxes, droppedQueries } = clock.measure('postprocess', () => {
      return selectDetections(outputs.class_logits.data, outputs.boxes.data, manifest.classes);
    });
    this.history = after(history, now, numFrames);
    const ages = window.slice(1).map((past) => now.timestamp_s - past.timestamp_s);
    return {
      skipped: null,
      history: { frames: window.length, reset_reason: reset, ages_s: ages },
      boxes,
      maps: maps.maps,
      dropped: { queries: droppedQueries, map_cells: maps.droppedCells },
      timings_ms: clock.milliseconds,
    };
  }

  /** The inputs that the decoder has. Those of a BEV-only model lack the projections. */
  ofDecoder(values) {
    const names = this.pipeline.graphs.get('decoder').spec.inputs.map((spec) => spec.name);
    return Object.fromEntries(Object.entries(values).filter(([name]) => names.includes(name)));
  }

  /** The outputs of the backbone and the lifter. */
  async encode(inputs, clock, observe) {
    const { graphs } = this.pipeline;
    const features = await clock.measure('backbone', () => graphs.get('backbone').run(inputs));
    observe('backbone', features);
    if (!graphs.has('lifter')) return features;
    const tables = await clock.measure('projector', () => this.liftingTables(inputs));
    observe('projector', tables);
    const lifted = await clock.measure('lifter', () => graphs.get('lifter').run({ ...features, ...tables }));
    observe('lifter', lifted);
    return { ...features, ...lifted };
  }

  /** The projector runs only if its inputs have changed. */
  async liftingTables(inputs) {
    const key = [...inputs.image_T_ego, ...inputs.camera_valid];
    if (this.tables === undefined || !key.every((value, index) => value === this.tables.key[index])) {
      this.tables = { key, tensors: await this.pipeline.graphs.get('projector').run(inputs) };
    }
    return this.tables.tensors;
  }

  /** The cached values as the decoder's inputs. */
  slots(window) {
    const { manifest, emptyMemory: empty } = this.pipeline;
    const inputs = {};
    for (let slot = 0; slot < manifest.window.num_frames; slot += 1) {
      for (const name of manifest.memory) inputs[slotName(slot, name)] = (window[slot]?.memory ?? empty).get(name);
    }
    return inputs;
  }

  async segment(features, clock, observe) {
    const tensors = await clock.measure('segmenter', () => this.pipeline.graphs.get('segmenter').run(features));
    observe('segmenter', tensors);
    const maps = new Map();
    let droppedCells = 0;
    for (const name of this.pipeline.manifest.map_classes) {
      const result = mapProbabilities(tensors[name].data);
      maps.set(name, result.probabilities);
      droppedCells += result.droppedCells;
    }
    return { maps, droppedCells };
  }
}

/** Measures the duration of each stage [ms]. */
class Clock {
  milliseconds = {};

  measure(stage, work) {
    const start = performance.now();
    const done = (value) => {
      this.milliseconds[stage] = performance.now() - start;
      return value;
    };
    const value = work();
    return value instanceof Promise ? value.then(done) : done(value);
  }
}

function skippedResult(reason) {
  return {
    skipped: reason,
    history: { frames: 0, reset_reason: null, ages_s: [] },
    boxes: [],
    maps: new Map(),
    dropped: { queries: 0, map_cells: 0 },
    timings_ms: {},
  };
}

/** Zeros for the slots without a frame. */
function emptyMemory(manifest) {
  const specs = new Map(manifest.graphs.decoder.inputs.map((spec) => [spec.name, spec]));
  return new Map(manifest.memory.map((name) => [name, new Float32Array(numElements(specs.get(slotName(0, name))))]));
}
