#!/usr/bin/env node
// Run a bundle over a scene folder: node node/run.js BUNDLE SCENE [--out results.jsonl] [--threads N]

import { open } from 'node:fs/promises';

import { readBundle } from '../lib/bundle.js';
import { Pipeline } from '../lib/pipeline.js';
import { frameResult } from '../lib/results.js';
import { readImages, readScene } from '../lib/scene.js';
import { parseCommand, runCommand } from './command.js';
import { loadJpeg, loadOrt, openFolder } from './engine.js';

const USAGE = 'node node/run.js BUNDLE SCENE [--out results.jsonl] [--threads N]';

await runCommand(async () => {
  const { folders, out, threads } = parseCommand(USAGE, 2, ['out', 'threads']);
  const bundle = await readBundle(await openFolder(folders[0]));
  const scene = await readScene(await openFolder(folders[1]), bundle.manifest.num_cameras);
  const [pipeline, jpeg] = [await Pipeline.load(loadOrt(threads), bundle), await loadJpeg()];
  const stream = pipeline.stream();
  const file = out === undefined ? undefined : await open(out, 'wx'); // only new files are written
  for (const frame of scene.frames) {
    const result = await stream.step(frame, await readImages(scene, frame, jpeg));
    const line = `${JSON.stringify(frameResult(frame, result))}\n`;
    if (file === undefined) await new Promise((resolve) => process.stdout.write(line, resolve));
    else await file.writeFile(line);
  }
  await file?.close();
  return 0;
});
