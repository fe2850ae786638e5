// Requests to the worker, as promises.

export class WorkerClient {
  /** @param {(text: string) => void} onProgress */
  constructor(onProgress) {
    this.worker = new Worker(new URL('./worker.js', import.meta.url), { type: 'module' });
    this.waiting = new Map();
    this.numRequests = 0;
    this.worker.addEventListener('message', ({ data }) => {
      if (data.progress !== undefined) {
        onProgress(data.progress);
        return;
      }
      if (!this.waiting.has(data.id)) return; // `fail` has answered it
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.problem) reject(data.problem);
      else resolve(data.answer);
    });
    this.worker.addEventListener('error', (event) => this.fail(event.message || 'the worker could not be started'));
  }

  /** Send a request. The promise is rejected with a problem: { part, where, expected, found, remedy }. */
  request(action, values = {}) {
    this.numRequests += 1;
    const id = this.numRequests;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage({ id, action, values });
    });
  }

  fail(message) {
    const remedy = 'Reload the page. The page needs a current browser, and a host that serves .wasm and .mjs files.';
    const problem = { part: 'page', where: 'the worker', expected: 'a running worker', found: message, remedy };
    for (const { reject } of this.waiting.values()) reject(problem);
    this.waiting.clear();
  }
}
