// What the consumer library needs from Node: onnxruntime-web, the JPEG decoder, and folders on a disk.

import { readdir, readFile, stat } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { availableParallelism } from 'node:os';
import path from 'node:path';

import jpegFactory from '@cornerstonejs/codec-libjpeg-turbo-8bit/decodewasmjs';
import * as ort from 'onnxruntime-web';

import { ConsumerError } from '../lib/errors.js';
import { Folder } from '../lib/folder.js';
import { loadJpegDecoder } from '../lib/image-files.js';

const require = createRequire(import.meta.url);

/** Return onnxruntime-web with a number of threads, by default one per core. */
export function loadOrt(threads = availableParallelism()) {
  ort.env.wasm.numThreads = threads;
  ort.env.logLevel = 'error';
  return ort;
}

export async function loadJpeg() {
  return loadJpegDecoder(
    jpegFactory,
    await readFile(require.resolve('@cornerstonejs/codec-libjpeg-turbo-8bit/decodewasm')),
  );
}

/** Return the files of a folder on the disk, subfolders included. Files are read when they are needed. */
export async function openFolder(root) {
  const files = new Map();
  const add = async (relative) => {
    const entries = await readdir(path.join(root, relative), { withFileTypes: true });
    for (const entry of entries) {
      const name = relative ? `${relative}/${entry.name}` : entry.name;
      const file = path.join(root, name);
      const found = await stat(file); // follows links
      if (found.isDirectory()) await add(name);
      else if (found.isFile())
        files.set(name, { size: found.size, read: async () => new Uint8Array(await readFile(file)) });
    }
  };
  try {
    await add('');
  } catch (error) {
    throw new ConsumerError(root, 'a folder that can be read', error.code ?? error.message, 'Check the path.');
  }
  return new Folder(root, files);
}
