// The built page in headless Chromium.

import { existsSync } from 'node:fs';
import { cp, mkdtemp } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import path from 'node:path';

import { chromium } from 'playwright-core';

import { serve } from '../../scripts/static-server.js';

export const CHROMIUM = process.env.DUOSPACENET_CHROMIUM ?? '/usr/bin/chromium';
const DIST = path.join(import.meta.dirname, '..', '..', 'dist');
const FLAGS = ['--headless=new', '--no-sandbox', '--disable-gpu', '--disable-background-networking'];
const TIMEOUT_MS = 120_000;

/** The options of a test that needs the page and Chromium. */
export const needsPage = {
  skip:
    (!existsSync(CHROMIUM) && `${CHROMIUM} is not installed`) ||
    (!existsSync(path.join(DIST, 'index.html')) && 'the page is not built: npm run build') ||
    (process.env.DUOSPACENET_FIXTURES === undefined && 'DUOSPACENET_FIXTURES is not set'),
  timeout: 2 * TIMEOUT_MS,
};

let browser; // one for all tests of a file

export async function closeBrowser() {
  await browser?.close();
}

/**
 * Open the page, and close it after the test.
 * @param {import('node:test').TestContext} t
 * @param {{isolated?: boolean, options?: object}} settings isolated: the host sends the headers. options: of the context
 */
export async function openPage(t, { isolated = true, options = {} } = {}) {
  const host = await serve(DIST, { isolated });
  browser ??= await chromium.launch({ executablePath: CHROMIUM, args: FLAGS });
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, ...options });
  t.after(async () => {
    await context.close();
    await host.close();
  });
  const page = await context.newPage();
  page.setDefaultTimeout(TIMEOUT_MS);
  const problems = [];
  const requests = [];
  page.on('pageerror', (error) => problems.push(error.message));
  page.on('console', (message) => message.type() === 'error' && problems.push(message.text()));
  context.on('request', (request) => requests.push(request.url()));
  await page.goto(host.url);
  await page.waitForSelector('html[data-ready]');
  return { page, host, problems, requests };
}

/** Pick a folder with the button of the page, and wait until the page has opened or refused it. */
export async function pickFolder(page, folder) {
  const chooser = page.waitForEvent('filechooser');
  await page.evaluate(() => document.getElementById('picker').click());
  await (await chooser).setFiles(folder);
  await waitUntilIdle(page);
}

/** Drop files and folders of the disk on the page. */
export async function drop(page, paths) {
  const client = await page.context().newCDPSession(page);
  const data = { items: [], files: paths, dragOperationsMask: 1 };
  for (const type of ['dragEnter', 'dragOver', 'drop']) {
    await client.send('Input.dispatchDragEvent', { type, x: 400, y: 400, data });
  }
  await waitUntilIdle(page);
}

export async function waitUntilIdle(page) {
  await page.waitForFunction(() => {
    const isBusy =
      document.getElementById('status').classList.contains('busy') || document.getElementById('open').disabled;
    const isShown = (id) => !document.getElementById(id).hidden;
    return (
      !isBusy && (isShown('problem') || isShown('start') || document.getElementById('position').textContent !== '')
    );
  });
}

/** Wait until the page shows the frame with a number, which counts from 1. */
export async function waitForFrame(page, number) {
  await page.waitForFunction(
    (start) => document.getElementById('position').textContent.startsWith(start),
    `${number} /`,
  );
  await waitUntilIdle(page);
}

/** A folder with copies of other folders, by their new names. */
export async function folderWith(copies) {
  const folder = await mkdtemp(path.join(tmpdir(), 'duospacenet-'));
  for (const [name, source] of Object.entries(copies)) {
    await cp(source, path.join(folder, name), { recursive: true, dereference: true });
  }
  return folder;
}
