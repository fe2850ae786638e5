// Which of the files that a user gave are a bundle, and which are a scene folder.

import { ConsumerError, printable } from './errors.js';
import { MANIFEST_NAME } from './manifest.js';
import { SCENE_NAME } from './scene.js';

const GIVE = `Give a bundle folder, with ${MANIFEST_NAME} in it, or a scene folder, with ${SCENE_NAME} in it.`;

/**
 * @param {import('./folder.js').Folder} folder everything that was given
 * @returns {{bundle?: object, scene?: object}} folders; at least one of them
 */
export function findSources(folder) {
  const bundles = folder.foldersWith(MANIFEST_NAME);
  // The golden scene of a bundle is a part of the bundle, and not a scene that the user chose.
  const isInBundle = (path) => bundles.some((bundle) => bundle === '' || path.startsWith(`${bundle}/`));
  const scenes = folder.foldersWith(SCENE_NAME).filter((path) => bundles.length === 0 || !isInBundle(path));
  if (bundles.length === 0 && scenes.length === 0) throw nothingFound(folder);
  if (bundles.length > 1) throw severalFound('bundle', bundles);
  if (scenes.length > 1) throw severalFound('scene folder', scenes);
  const table = scenes.map((path) => folder.sub(path)).find((scene) => scene.has('sample_data.json'));
  if (table !== undefined) {
    const remedy = 'Convert some of its frames with examples/nuscenes_scene.py.';
    throw new ConsumerError(table.name, 'a scene folder', 'the tables of a nuScenes root', remedy);
  }
  return {
    ...(bundles.length === 1 && { bundle: folder.sub(bundles[0]) }),
    ...(scenes.length === 1 && { scene: folder.sub(scenes[0]) }),
  };
}

function nothingFound(folder) {
  const { paths } = folder;
  const archive = paths.find((path) => /\.(zip|tar|tgz|gz|7z|rar|zst)$/i.test(path));
  if (archive !== undefined) {
    return new ConsumerError(archive, 'a folder', 'an archive', 'Unpack it, and give the folder.');
  }
  const graph = paths.find((path) => path.endsWith('.onnx'));
  if (graph !== undefined) {
    return new ConsumerError(graph, `a bundle, with ${MANIFEST_NAME} beside its graphs`, 'a graph alone', GIVE);
  }
  if (paths.length === 0) return new ConsumerError(folder.name || 'the drop', 'a folder', 'no files', GIVE);
  const examples = paths.slice(0, 3).map(printable).join(', ');
  const found = `${paths.length} file${paths.length === 1 ? '' : 's'} without them: ${examples}${paths.length > 3 ? ', …' : ''}`;
  return new ConsumerError(folder.name || 'the files', `${MANIFEST_NAME} or ${SCENE_NAME}`, found, GIVE);
}

function severalFound(kind, paths) {
  const examples = paths
    .slice(0, 3)
    .map((path) => printable(path || 'the folder itself'))
    .join(', ');
  return new ConsumerError('the files', `one ${kind}`, `${paths.length}: ${examples}`, 'Give one of them.');
}
