// Camera images: JPEG and PNG files, decoded to the same pixels as in OpenCV. The browser's own decoder is not used:
// it applies colour profiles, transparency and EXIF orientation.

import { convertIndexedToRgb, decode as decodePngFile } from 'fast-png';

import { SceneError } from './errors.js';
import { emptyImage } from './resize.js';

const MAX_IMAGE_PX = 100_000_000;
const PNG_START = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const JPEG_START = [0xff, 0xd8, 0xff];
const COPY_AGAIN = 'Copy the file again.';

// Other files that are given as images, by their first bytes.
const OTHER_KINDS = [
  ['a WebP image', /^RIFF....WEBP/s],
  ['a GIF image', /^GIF8[79]a/],
  ['a BMP image', /^BM/],
  ['a TIFF image', /^(II[*+]\0|MM\0[*+])/],
  ['a HEIC or AVIF image', /^....ftyp(hei|hev|mif|msf|avi[fs])/s],
  ['a git-lfs pointer', /^version https:\/\/git-lfs/],
  ['a compressed archive', /^(PK\x03\x04|\x1f\x8b|7z\xbc\xaf)/],
  ['a web page', /^\s*<(!doctype|html)/i],
];

/**
 * Decode an image file to { width, height, data }: (height, width, 3) 8-bit BGR.
 * @param {Uint8Array} bytes
 * @param {string} where the file, for messages
 * @param {{width_px: number, height_px: number}} camera whose calibration gives the size
 * @param {{decode: (bytes: Uint8Array) => {width: number, height: number, components: number, data: Uint8Array}}} jpeg
 *   the decoder that `loadJpegDecoder` returned
 */
export function decodeImage(bytes, where, camera, jpeg) {
  const header = pngHeader(bytes) ?? jpegHeader(bytes);
  if (header === undefined) {
    const [found, remedy] = describe(bytes);
    throw new SceneError(where, 'a JPEG or PNG image', found, remedy);
  }
  checkHeader(header, where, camera);
  try {
    return header.isPng ? decodePng(bytes, header) : decodeJpeg(bytes, header, jpeg);
  } catch (error) {
    const kind = header.isPng ? 'PNG' : 'JPEG';
    const found = `a ${kind} file of ${bytes.length} bytes that cannot be decoded (${error?.message ?? 'damaged'})`;
    throw new SceneError(where, 'an undamaged image', found, COPY_AGAIN);
  }
}

/**
 * Load libjpeg-turbo, which computes the same pixels as OpenCV.
 * @param {(options: object) => Promise<object>} factory of @cornerstonejs/codec-libjpeg-turbo-8bit/decodewasmjs
 * @param {Uint8Array} wasm of @cornerstonejs/codec-libjpeg-turbo-8bit/decodewasm
 */
export async function loadJpegDecoder(factory, wasm) {
  const library = await factory({ wasmBinary: wasm, print: () => {}, printErr: () => {} });
  return {
    decode(bytes) {
      const decoder = new library.JPEGDecoder();
      try {
        decoder.getEncodedBuffer(bytes.length).set(bytes);
        decoder.decode();
        const { width, height, componentCount } = decoder.getFrameInfo();
        return { width, height, components: componentCount, data: decoder.getDecodedBuffer().slice() };
      } catch {
        throw new Error('libjpeg reports damage'); // it throws a number, which has no text
      } finally {
        decoder.delete();
      }
    },
  };
}

function checkHeader(header, where, camera) {
  const { width, height, bits, components } = header;
  if (width !== camera.width_px || height !== camera.height_px) {
    const remedy = 'Correct width_px and height_px with the intrinsics, or use the original image.';
    const expected = `${camera.width_px}x${camera.height_px} px, as the calibration says`;
    throw new SceneError(where, expected, `${width}x${height} px`, remedy);
  }
  if (width * height > MAX_IMAGE_PX) {
    throw new SceneError(where, `at most ${MAX_IMAGE_PX} pixels`, `${width}x${height} px`, 'Scale the image down.');
  }
  if (bits > 8) throw new SceneError(where, '8 bits per channel', `${bits}`, 'Scale the values to 0 to 255.');
  if (!header.isPng && components === 4) {
    throw new SceneError(where, 'a colour or grey JPEG file', 'a CMYK file', 'Convert it to RGB.');
  }
}

function pngHeader(bytes) {
  if (!startsWith(bytes, PNG_START) || bytes.length < 33 || latin(bytes, 12, 16) !== 'IHDR') return undefined;
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  return { isPng: true, width: view.getUint32(16), height: view.getUint32(20), bits: bytes[24] };
}

/** The size in the start-of-frame segment. Segments are skipped by their lengths, so a thumbnail is not found. */
function jpegHeader(bytes) {
  if (!startsWith(bytes, JPEG_START)) return undefined;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  let offset = 2;
  while (offset + 10 <= bytes.length && bytes[offset] === 0xff) {
    const marker = bytes[offset + 1];
    if (marker === 0xff) {
      offset += 1;
    } else if (marker >= 0xc0 && marker <= 0xcf && ![0xc4, 0xc8, 0xcc].includes(marker)) {
      const [height, width] = [view.getUint16(offset + 5), view.getUint16(offset + 7)];
      return { isPng: false, width, height, bits: bytes[offset + 4], components: bytes[offset + 9] };
    } else if (marker === 0xd9 || marker === 0xda) {
      return undefined;
    } else {
      offset += 2 + view.getUint16(offset + 2);
    }
  }
  return undefined;
}

function decodePng(bytes, header) {
  const png = decodePngFile(bytes, { checkCrc: true });
  const image = emptyImage(header.width, header.height);
  const numPixels = header.width * header.height;
  const { data, channels } = samples(png);
  if (data.length < numPixels * channels) throw new Error('pixels are missing');
  const isGrey = channels < 3;
  for (let from = 0, to = 0; to < image.data.length; from += channels, to += 3) {
    image.data[to] = data[isGrey ? from : from + 2];
    image.data[to + 1] = data[isGrey ? from : from + 1];
    image.data[to + 2] = data[from];
  }
  return image;
}

/** The samples of a PNG file with 8 bits each. Transparency is not applied. */
function samples(png) {
  if (png.palette) {
    const data = convertIndexedToRgb(png);
    return { data, channels: data.length / (png.width * png.height) };
  }
  if (png.depth === 8) return png;
  const data = new Uint8Array(png.width * png.height);
  const [perByte, largest] = [8 / png.depth, 2 ** png.depth - 1];
  const stride = Math.ceil(png.width / perByte);
  for (let i = 0; i < data.length; i += 1) {
    const [x, y] = [i % png.width, Math.floor(i / png.width)];
    const shift = 8 - png.depth * ((x % perByte) + 1);
    data[i] = (((png.data[y * stride + Math.floor(x / perByte)] >> shift) & largest) * 255) / largest;
  }
  return { data, channels: 1 };
}

function decodeJpeg(bytes, header, jpeg) {
  const { width, height, components, data } = jpeg.decode(bytes);
  if (width !== header.width || height !== header.height) throw new Error(`a second size of ${width}x${height} px`);
  const image = emptyImage(width, height);
  const isGrey = components === 1;
  for (let from = 0, to = 0; to < image.data.length; from += components, to += 3) {
    image.data[to] = data[isGrey ? from : from + 2];
    image.data[to + 1] = data[isGrey ? from : from + 1];
    image.data[to + 2] = data[from];
  }
  return image;
}

function describe(bytes) {
  if (bytes.length === 0) return ['an empty file', COPY_AGAIN];
  const kind = OTHER_KINDS.find(([, start]) => start.test(latin(bytes, 0, 32)));
  if (kind) return [`${kind[0]} of ${bytes.length} bytes`, 'Convert it to PNG or JPEG.'];
  const isDamaged = startsWith(bytes, PNG_START) || startsWith(bytes, JPEG_START);
  const first = [...bytes.subarray(0, 4)].map((byte) => byte.toString(16).padStart(2, '0')).join(' ');
  const found = isDamaged ? 'an image without its header' : `a file that starts with the bytes ${first}`;
  return [`${found}, ${bytes.length} bytes`, COPY_AGAIN];
}

function startsWith(bytes, start) {
  return start.every((byte, index) => bytes[index] === byte);
}

function latin(bytes, start, end) {
  return String.fromCharCode(...bytes.subarray(start, end));
}
