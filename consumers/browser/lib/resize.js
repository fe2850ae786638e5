// The resizes of the bundle format, with the same pixels as OpenCV: halvings, INTER_AREA and INTER_LINEAR.
// An image is { width, height, data }, with three interleaved channels of 8 bits.

const CHANNELS = 3;
const round = Math.fround;

export function emptyImage(width, height) {
  return { width, height, data: new Uint8Array(width * height * CHANNELS) };
}

/** Return the part of an image that starts at (left, top). */
export function crop(image, left, top, width, height) {
  const cropped = emptyImage(width, height);
  for (let y = 0; y < height; y += 1) {
    const start = ((top + y) * image.width + left) * CHANNELS;
    cropped.data.set(image.data.subarray(start, start + width * CHANNELS), y * width * CHANNELS);
  }
  return cropped;
}

/** Replace each block of 2x2 pixels by its mean, halves rounded up. An odd last row or column is left out. */
export function halve(image) {
  const half = emptyImage(image.width >> 1, image.height >> 1);
  const [source, target, stride] = [image.data, half.data, image.width * CHANNELS];
  let to = 0;
  for (let y = 0; y < half.height; y += 1) {
    let from = 2 * y * stride;
    for (let x = 0; x < half.width; x += 1, from += CHANNELS) {
      for (let channel = 0; channel < CHANNELS; channel += 1, from += 1, to += 1) {
        const sum = source[from] + source[from + CHANNELS] + source[from + stride] + source[from + stride + CHANNELS];
        target[to] = (sum + 2) >> 2;
      }
    }
  }
  return half;
}

/** Resize as OpenCV's INTER_AREA. `width` and `height` are at most those of the image. */
export function resizeArea(image, width, height) {
  const [factorX, factorY] = [image.width / width, image.height / height];
  if (Number.isInteger(factorX) && Number.isInteger(factorY)) return resizeByMeans(image, width, height);
  const [columns, rows] = [areaWeights(image.width, width), areaWeights(image.height, height)];
  const resized = emptyImage(width, height);
  const [line, sum] = [new Float32Array(width * CHANNELS), new Float32Array(width * CHANNELS)];
  for (let y = 0; y < height; y += 1) {
    sum.fill(0);
    for (let term = rows.starts[y]; term < rows.starts[y + 1]; term += 1) {
      weighColumns(image, rows.indices[term], columns, line);
      const weight = rows.weights[term];
      for (let i = 0; i < sum.length; i += 1) sum[i] += round(weight * line[i]);
    }
    for (let i = 0; i < sum.length; i += 1) resized.data[y * sum.length + i] = toByte(sum[i]);
  }
  return resized;
}

/** Resize as OpenCV's INTER_LINEAR, whose weights for 8-bit images are multiples of 1/2048. */
export function resizeLinear(image, width, height) {
  const [columns, rows] = [linearWeights(image.width, width), linearWeights(image.height, height)];
  const resized = emptyImage(width, height);
  const lines = new Map();
  for (let y = 0; y < height; y += 1) {
    const { index, next, weights } = rows[y];
    for (const row of lines.keys()) if (row !== index && row !== next) lines.delete(row);
    for (const row of [index, next]) if (!lines.has(row)) lines.set(row, interpolatedLine(image, row, columns));
    const [upper, lower] = [lines.get(index), lines.get(next)];
    const target = resized.data.subarray(y * width * CHANNELS);
    for (let i = 0; i < width * CHANNELS; i += 1) {
      const value = ((weights[0] * (upper[i] >> 4)) >> 16) + ((weights[1] * (lower[i] >> 4)) >> 16);
      target[i] = Math.min(255, Math.max(0, (value + 2) >> 2));
    }
  }
  return resized;
}

/** Round to the nearest integer, halves to the even one. */
export function roundHalfToEven(value) {
  const floor = Math.floor(value);
  const rest = value - floor;
  if (rest !== 0.5) return rest < 0.5 ? floor : floor + 1;
  return floor % 2 === 0 ? floor : floor + 1;
}

/** INTER_AREA by whole factors: sums of integers, times the float32 reciprocal of their number. */
function resizeByMeans(image, width, height) {
  const [factorX, factorY] = [image.width / width, image.height / height];
  if (factorX === 2 && factorY === 2) return halve(image);
  const resized = emptyImage(width, height);
  const scale = round(1 / (factorX * factorY));
  let to = 0;
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1) {
      for (let channel = 0; channel < CHANNELS; channel += 1, to += 1) {
        let sum = 0;
        for (let row = y * factorY; row < (y + 1) * factorY; row += 1) {
          const start = (row * image.width + x * factorX) * CHANNELS + channel;
          for (let k = 0; k < factorX; k += 1) sum += image.data[start + k * CHANNELS];
        }
        resized.data[to] = toByte(round(round(sum) * scale));
      }
    }
  }
  return resized;
}

/**
 * The source indices that each target index covers, with their float32 weights in OpenCV's order. Those of target t are
 * in the places starts[t] to starts[t + 1] - 1.
 */
function areaWeights(sourceSize, targetSize) {
  const scale = 1 / (targetSize / sourceSize); // OpenCV computes it in these two steps
  const [starts, indices, weights] = [[0], [], []];
  const add = (index, weight) => {
    indices.push(index);
    weights.push(weight);
  };
  for (let target = 0; target < targetSize; target += 1) {
    const [start, end] = [target * scale, target * scale + scale];
    const cell = Math.min(scale, sourceSize - start);
    const last = Math.min(Math.floor(end), sourceSize - 1);
    const first = Math.min(Math.ceil(start), last);
    if (first - start > 1e-3) add(first - 1, (first - start) / cell);
    for (let index = first; index < last; index += 1) add(index, 1 / cell);
    if (end - last > 1e-3) add(last, Math.min(end - last, 1, cell) / cell);
    starts.push(indices.length);
  }
  return { starts: Int32Array.from(starts), indices: Int32Array.from(indices), weights: Float32Array.from(weights) };
}

/** Add up the pixels of a row with the weights of the columns. `line` gets the sums, rounded to float32 after each. */
function weighColumns(image, row, { starts, indices, weights }, line) {
  const [data, start] = [image.data, row * image.width * CHANNELS];
  for (let x = 0, to = 0; x + 1 < starts.length; x += 1, to += CHANNELS) {
    let [blue, green, red] = [0, 0, 0];
    for (let term = starts[x]; term < starts[x + 1]; term += 1) {
      const [from, weight] = [start + indices[term] * CHANNELS, weights[term]];
      blue = round(blue + round(data[from] * weight));
      green = round(green + round(data[from + 1] * weight));
      red = round(red + round(data[from + 2] * weight));
    }
    line[to] = blue;
    line[to + 1] = green;
    line[to + 2] = red;
  }
}

/** For each target index, two source indices with their weights. They are one index at a border. */
function linearWeights(sourceSize, targetSize) {
  const scale = 1 / (targetSize / sourceSize);
  const clamped = (index) => Math.min(Math.max(index, 0), sourceSize - 1);
  return Array.from({ length: targetSize }, (_, target) => {
    const position = round((target + 0.5) * scale - 0.5);
    const index = Math.floor(position);
    const share = round(position - index);
    const weights = [round(1 - share), share].map((weight) => roundHalfToEven(round(weight * 2048)));
    return { index: clamped(index), next: clamped(index + 1), weights };
  });
}

function interpolatedLine(image, row, columns) {
  const line = new Int32Array(columns.length * CHANNELS);
  const start = row * image.width * CHANNELS;
  columns.forEach(({ index, next, weights }, x) => {
    for (let channel = 0; channel < CHANNELS; channel += 1) {
      const [here, there] = [
        image.data[start + index * CHANNELS + channel],
        image.data[start + next * CHANNELS + channel],
      ];
      line[x * CHANNELS + channel] = here * weights[0] + there * weights[1];
    }
  });
  return line;
}

function toByte(value) {
  return Math.min(255, Math.max(0, roundHalfToEven(value)));
}
