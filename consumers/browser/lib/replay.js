// The frames of a scene in any order, each with the result that it has in a run from the first frame to the last.
//
// A result depends on the frame itself and on the past frames in its window. Poses, times and lost cameras say which
// these are, so the window is known before any image is read. After a jump, only the frames of the window are run.

import { after, pastFrame, resetReason } from './history.js';
import { readImages } from './scene.js';

export class Replay {
  /**
   * @param {import('./pipeline.js').Pipeline} pipeline
   * @param {{folder: object, frames: object[]}} scene
   * @param {object} jpeg see `decodeImage`
   */
  constructor(pipeline, scene, jpeg) {
    Object.assign(this, { pipeline, scene, jpeg });
    this.windows = pastWindows(scene.frames, pipeline.manifest.window);
    this.restart();
  }

  /**
   * Process the frame `index`.
   * @param {(done: number, all: number) => void} onProgress called before each frame that is run
   * @returns {Promise<{result: object, images: Map<string, object | null>}>}
   */
  async frame(index, onProgress = () => {}) {
    const { past, reset } = this.windows[index];
    const isNext = past.length === this.processed.length && past.every((one, k) => one === this.processed[k]);
    if (!isNext) await this.rerun(past, onProgress);
    onProgress(isNext ? 0 : past.length, isNext ? 1 : past.length + 1);
    const { result, images } = await this.step(index);
    if (result.skipped !== null) return { result, images };
    this.processed = after(past, index, this.pipeline.manifest.window.num_frames);
    return { result: { ...result, history: { ...result.history, reset_reason: reset } }, images };
  }

  restart() {
    this.stream = this.pipeline.stream({ maps: true });
    this.processed = []; // indices of the frames in the stream's history, newest first
  }

  /** Run the frames of a window again, so that the stream has this history. */
  async rerun(past, onProgress) {
    this.restart();
    try {
      for (const [done, index] of [...past].reverse().entries()) {
        onProgress(done, past.length + 1);
        await this.step(index);
      }
    } catch (error) {
      this.restart(); // the history is incomplete
      throw error;
    }
    this.processed = past;
  }

  async step(index) {
    const frame = this.scene.frames[index];
    const start = performance.now();
    const images = await readImages(this.scene, frame, this.jpeg);
    const decode = performance.now() - start;
    const result = await this.stream.step(frame, images);
    return { result: { ...result, timings_ms: { decode, ...result.timings_ms } }, images };
  }
}

/**
 * For each frame, the indices of the past frames in the history that it continues, newest first, and the reason of a
 * reset before it, or null.
 */
function pastWindows(frames, window) {
  let history = [];
  return frames.map((frame, index) => {
    const last = history.length > 0 ? pastFrame(frames[history[0]]) : undefined;
    const reset = resetReason(last, frame, window);
    const past = reset === null ? history : [];
    const isSkipped = [...frame.cameras.values()].every((camera) => camera.image === null);
    if (!isSkipped) history = after(past, index, window.num_frames);
    return { past, reset };
  });
}
