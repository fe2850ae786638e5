import assert from 'node:assert/strict';
import test from 'node:test';

import { Folder, normalised } from '../lib/folder.js';
import { findSources } from '../lib/sources.js';
import { folderOf } from './fixtures.js';

test('a bundle and a scene folder are found at any depth', () => {
  const { bundle, scene } = findSources(
    folderOf({ 'a/nano/manifest.json': '', 'a/rig/scene.json': '', 'a/rig/images/1.png': '' }),
  );
  assert.deepEqual([bundle.paths, scene.paths], [['manifest.json'], ['scene.json', 'images/1.png']]);
});

test('the golden scene belongs to its bundle', () => {
  const { bundle, scene } = findSources(folderOf({ 'manifest.json': '', 'golden/scene/scene.json': '' }));
  assert.equal(bundle.paths.length, 2);
  assert.equal(scene, undefined);
});

for (const [name, contents, message] of [
  ['an archive', { 'bundle.zip': '' }, /bundle\.zip: expected a folder; found an archive\. Unpack it/],
  [
    'a graph alone',
    { 'backbone.onnx': '' },
    /expected a bundle, with manifest\.json beside its graphs; found a graph alone/,
  ],
  [
    'images alone',
    { 'a/1.png': '', 'a/2.png': '' },
    /expected manifest\.json or scene\.json; found 2 files without them: a\/1\.png, a\/2\.png/,
  ],
  ['nothing', {}, /expected a folder; found no files/],
  ['two bundles', { 'a/manifest.json': '', 'b/manifest.json': '' }, /expected one bundle; found 2: a, b/],
  ['two scenes', { 'a/scene.json': '', 'b/scene.json': '' }, /expected one scene folder; found 2: a, b/],
  [
    'nuScenes tables',
    { 'v1.0-mini/scene.json': '', 'v1.0-mini/sample_data.json': '' },
    /found the tables of a nuScenes root/,
  ],
]) {
  test(`${name} is refused`, () => assert.throws(() => findSources(folderOf(contents)), message));
}

test('files that operating systems add are left out', () => {
  const file = new Blob(['x']);
  const folder = Folder.ofFiles('drop', [
    ['a/.DS_Store', file],
    ['a/scene.json', file],
    ['__MACOSX/a/scene.json', file],
    ['a/._scene.json', file],
  ]);
  assert.deepEqual(folder.paths, ['a/scene.json']);
});

test('paths stay in their folder', () => {
  assert.equal(normalised('./images//a/../1.png'), 'images/1.png');
  for (const path of ['/etc/passwd', '../1.png', 'a/../../1.png', 'C:/1.png', 'a\\..\\1.png', '', '.']) {
    assert.equal(normalised(path), undefined, path);
  }
});
