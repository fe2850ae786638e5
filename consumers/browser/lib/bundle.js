// A bundle folder: the manifest, and the bytes of each graph, whose hashes were checked.

import { sha256 } from '@noble/hashes/sha2.js';
import { bytesToHex } from '@noble/hashes/utils.js';

import { BundleError } from './errors.js';
import { MANIFEST_NAME, readManifest } from './manifest.js';

const MAX_GRAPH_BYTES = 2 ** 31 - 1;

/**
 * Read and check a bundle.
 * @param {import('./folder.js').Folder} folder
 * @returns {Promise<{manifest: object, graphs: Map<string, Uint8Array>, folder: object}>}
 */
export async function readBundle(folder) {
  if (!folder.has(MANIFEST_NAME)) {
    const remedy = 'Give the folder that `duospacenet export` wrote.';
    throw new BundleError(folder.name, `a bundle, with ${MANIFEST_NAME} in it`, 'a folder without it', remedy);
  }
  const manifest = readManifest(await folder.read(MANIFEST_NAME));
  const graphs = new Map();
  for (const [name, graph] of Object.entries(manifest.graphs)) graphs.set(name, await readGraph(folder, name, graph));
  return { manifest, graphs, folder };
}

/** Read a file whose hash the manifest gives. */
export async function readHashed(folder, path, digest, remedy) {
  const bytes = await folder.read(path);
  const found = bytesToHex(sha256(bytes));
  if (found !== digest) {
    throw new BundleError(
      path,
      `the SHA-256 ${digest.slice(0, 12)}… of the manifest`,
      `${found.slice(0, 12)}…, ${bytes.length} bytes`,
      remedy,
    );
  }
  return bytes;
}

async function readGraph(folder, name, graph) {
  if (!folder.has(graph.file)) {
    const remedy = 'Copy the whole folder, or export again.';
    throw new BundleError(graph.file, `the bundle's ${name} graph`, 'no such file', remedy);
  }
  const { size } = folder.files.get(graph.file);
  if (size > MAX_GRAPH_BYTES) {
    throw new BundleError(graph.file, `at most ${MAX_GRAPH_BYTES} bytes`, `${size} bytes`, 'Export again.');
  }
  const remedy = 'The file is damaged or belongs to another bundle: copy the whole folder, or export again.';
  return readHashed(folder, graph.file, graph.sha256, remedy);
}
