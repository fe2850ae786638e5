// Runs graphs in onnxruntime-web (WebAssembly) for Python, which sends requests on stdin and reads results on stdout.
//
//   node runner.mjs FOLDER THREADS        FOLDER has the folder node_modules with onnxruntime-web
//
// A message is one line of JSON, followed by the bytes that it announces.
//   {"load": GRAPH, "bytes": N}  and the file       ->  {"inputs": [TENSOR...], "outputs": [TENSOR...]}
//   {"run": GRAPH, "inputs": [TENSOR...]}  and data  ->  {"outputs": [TENSOR...]}  and data
// TENSOR is {"name", "dtype", "shape"}; dtype is float32, uint8 or bool. Data are row-major and little-endian, one tensor
// after the other. A request that fails gets {"error": TEXT}. The process ends when stdin does.

import { createRequire } from 'node:module';
import path from 'node:path';

// Whatever a library prints must not mix with the results.
console.log = console.info = console.debug = (...words) => console.error(...words);

const BYTES = { float32: 4, uint8: 1, bool: 1 };
const ARRAYS = { float32: Float32Array, uint8: Uint8Array, bool: Uint8Array };

const [folder, threads] = process.argv.slice(2);
const ort = createRequire(path.resolve(folder, 'runner.cjs'))('onnxruntime-web');
ort.env.wasm.numThreads = Number(threads);
ort.env.logLevel = 'error';

const sessions = new Map();

async function load({ load: name }, content) {
  const options = { executionProviders: ['wasm'], graphOptimizationLevel: 'all' };
  const session = await ort.InferenceSession.create(content, options);
  sessions.set(name, session);
  return { reply: { inputs: describe(session.inputMetadata), outputs: describe(session.outputMetadata) } };
}

async function run({ run: name, inputs }, content) {
  const feeds = {};
  let offset = 0;
  for (const spec of inputs) {
    const end = offset + numBytes(spec);
    const copy = new Uint8Array(content.subarray(offset, end)); // typed arrays need an aligned buffer
    const data = new ARRAYS[spec.dtype](copy.buffer);
    feeds[spec.name] = new ort.Tensor(spec.dtype, data, spec.shape);
    offset = end;
  }
  const session = sessions.get(name);
  const results = await session.run(feeds);
  const tensors = session.outputNames.map((output) => results[output]);
  const outputs = tensors.map(({ type, dims }, index) => ({ name: session.outputNames[index], dtype: type, shape: dims }));
  return {
    reply: { outputs },
    data: tensors.map(({ data }) => Buffer.from(data.buffer, data.byteOffset, data.byteLength)),
  };
}

const describe = (metadata) => metadata.map(({ name, type, shape }) => ({ name, dtype: type, shape: [...shape] }));

const numBytes = ({ dtype, shape }) => shape.reduce((product, size) => product * size, BYTES[dtype]);

const announcedBytes = (request) => request.bytes ?? request.inputs.reduce((sum, spec) => sum + numBytes(spec), 0);

async function answer(request, content) {
  let result;
  try {
    result = await ('load' in request ? load(request, content) : run(request, content));
  } catch (error) {
    result = { reply: { error: String(error?.message ?? error) } };
  }
  await write(Buffer.from(`${JSON.stringify(result.reply)}\n`));
  for (const data of result.data ?? []) await write(data);
}

function write(data) {
  return new Promise((resolve, reject) => process.stdout.write(data, (error) => (error ? reject(error) : resolve())));
}

/** Reads lines and bytes from stdin. */
class Reader {
  #stream = process.stdin[Symbol.asyncIterator]();
  #chunks = [];
  #length = 0;

  /** The next line; undefined at the end. */
  async line() {
    let end;
    while ((end = this.#chunks.length ? Buffer.concat(this.#chunks).indexOf(10) : -1) < 0) {
      if (!(await this.#more())) return undefined;
    }
    return (await this.bytes(end + 1)).subarray(0, end).toString();
  }

  async bytes(length) {
    while (this.#length < length) {
      if (!(await this.#more())) throw new Error('stdin ended within a request');
    }
    const all = Buffer.concat(this.#chunks);
    this.#chunks = [all.subarray(length)];
    this.#length = all.length - length;
    return all.subarray(0, length);
  }

  async #more() {
    const { value, done } = await this.#stream.next();
    if (done) return false;
    this.#chunks.push(value);
    this.#length += value.length;
    return true;
  }
}

await write(Buffer.from(`${JSON.stringify({ version: ort.env.versions.web })}\n`));
const reader = new Reader();
let line;
while ((line = await reader.line()) !== undefined) {
  const request = JSON.parse(line);
  await answer(request, await reader.bytes(announcedBytes(request)));
}
process.exit(0); // the threads of onnxruntime-web would keep the process alive
