#!/usr/bin/env node
// Run the golden example of a bundle: node node/verify.js BUNDLE [--threads N]. Exit code 1 if a value differs.

import { readBundle } from '../lib/bundle.js';
import { printable } from '../lib/errors.js';
import { readGolden, verify } from '../lib/golden.js';
import { Pipeline } from '../lib/pipeline.js';
import { parseCommand, runCommand } from './command.js';
import { loadJpeg, loadOrt, openFolder } from './engine.js';

const SHOWN = 10;

await runCommand(async () => {
  const { folders, threads } = parseCommand('node node/verify.js BUNDLE [--threads N]', 1, ['threads']);
  const bundle = await readBundle(await openFolder(folders[0]));
  const golden = await readGolden(bundle);
  const ort = loadOrt(threads);
  const report = await verify(await Pipeline.load(ort, bundle), golden, await loadJpeg());
  for (const { frame, tensor, index, expected, found } of report.differences.slice(0, SHOWN)) {
    console.log(printable(`differs frame ${frame}, ${tensor}[${index}]: expected ${expected}; found ${found}`));
  }
  const engine = `onnxruntime-web ${ort.env.versions.web}`;
  const compared = `${report.frames} frames, ${report.tensors} tensors, ${report.values} values`;
  if (report.passed)
    console.log(
      `verified: ${compared}; largest error ${report.largestShare.toPrecision(2)} of its tolerance; ${engine}`,
    );
  else console.log(`NOT verified: ${report.count} differences in ${compared}; ${engine}`);
  return report.passed ? 0 : 1;
});
