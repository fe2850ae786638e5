// The decoder's outputs as a list of boxes, sorted by score: see "Decoding and selection" in docs/frame-steps.md.

const MAX_DETECTIONS = 500;
const BOX_NUMBERS = 9;

/** 1 / (1 + exp(-x)) in float32, in the form that never overflows. */
export function sigmoid(logit) {
  const power = Math.fround(Math.exp(-Math.abs(logit)));
  return Math.fround((logit >= 0 ? 1 : power) / Math.fround(1 + power));
}

/**
 * Select the (query, class) pairs with the highest scores.
 * @param {Float32Array} logits (Q, classes)
 * @param {Float32Array} boxes (Q, 9)
 * @param {string[]} classes
 * @returns {{boxes: {query: number, class: string, score: number, box: number[]}[], droppedQueries: number}}
 */
export function selectDetections(logits, boxes, classes) {
  const numQueries = boxes.length / BOX_NUMBERS;
  const pairs = [];
  let droppedQueries = 0;
  for (let query = 0; query < numQueries; query += 1) {
    const rowOfLogits = logits.subarray(query * classes.length, (query + 1) * classes.length);
    const box = boxes.subarray(query * BOX_NUMBERS, (query + 1) * BOX_NUMBERS);
    if (rowOfLogits.every(Number.isFinite) && box.every(Number.isFinite)) {
      rowOfLogits.forEach((logit, label) => pairs.push({ query, label, score: sigmoid(logit) }));
    } else droppedQueries += 1;
  }
  pairs.sort((one, other) => other.score - one.score); // stable: ties keep the order of queries and classes
  const selected = pairs.slice(0, MAX_DETECTIONS).map(({ query, label, score }) => ({
    query,
    class: classes[label],
    score,
    box: Array.from(boxes.subarray(query * BOX_NUMBERS, (query + 1) * BOX_NUMBERS)),
  }));
  return { boxes: selected, droppedQueries };
}

/**
 * Turn the logits of a map class into probabilities. A cell that is not finite gets 0.
 * @returns {{probabilities: Float32Array, droppedCells: number}}
 */
export function mapProbabilities(logits) {
  let droppedCells = 0;
  const probabilities = Float32Array.from(logits, (logit) => {
    if (Number.isFinite(logit)) return sigmoid(logit);
    droppedCells += 1;
    return 0;
  });
  return { probabilities, droppedCells };
}
