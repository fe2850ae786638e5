#!/usr/bin/env node
// Serve the built page on this computer: npm run serve -- [PORT]. Any static host does the same.

import { serve } from './static-server.js';

const { url } = await serve(new URL('../dist', import.meta.url).pathname, {
  port: Number(process.argv[2] ?? 8080),
  isolated: true,
});
console.log(`Open ${url}`);
