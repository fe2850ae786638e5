#!/usr/bin/env node
// Put a bundle, and if given a scene folder, beside the page for its button "Demo":
//   npm run demo -- BUNDLE [SCENE]
// Without a scene folder, the demo shows the golden scene of the bundle. Run it before `npm run build`.

import { cp, mkdir, rm, writeFile } from 'node:fs/promises';
import path from 'node:path';

import { MANIFEST_NAME } from '../lib/manifest.js';
import { SCENE_NAME } from '../lib/scene.js';
import { openFolder } from '../node/engine.js';

const OUT = path.join(import.meta.dirname, '..', 'public', 'demo');
const [bundle, scene] = process.argv.slice(2);

if (bundle === undefined) {
  console.error('Usage: npm run demo -- BUNDLE [SCENE]');
  process.exit(2);
}
await rm(OUT, { recursive: true, force: true });
await copy(bundle, 'bundle', MANIFEST_NAME);
if (scene !== undefined) await copy(scene, 'scene', SCENE_NAME);
const folder = await openFolder(OUT);
const files = [...folder.files].map(([file, { size }]) => ({ path: file, size }));
await writeFile(path.join(OUT, 'files.json'), `${JSON.stringify(files)}\n`);
console.log(`${files.length} files in ${path.relative(process.cwd(), OUT)}`);
process.exit();

async function copy(source, name, needed) {
  const folder = await openFolder(source);
  if (!folder.has(needed)) {
    console.error(`${source}: expected a folder with ${needed}; found none.`);
    process.exit(3);
  }
  await mkdir(OUT, { recursive: true });
  await cp(source, path.join(OUT, name), { recursive: true, dereference: true });
}
