// The frames that were computed: all results, and the pictures of the last ones.

const MAX_PICTURES = 40; // six pictures of 960x540 take 12 MB

export class FrameCache {
  constructor() {
    this.clear();
  }

  clear() {
    for (const pictures of this.pictures?.values() ?? []) close(pictures);
    this.results = new Map();
    this.pictures = new Map(); // the last used at the end
  }

  has(index) {
    return this.results.has(index);
  }

  addPictures(index, pictures) {
    this.pictures.delete(index);
    this.pictures.set(index, pictures);
    while (this.pictures.size > MAX_PICTURES) {
      const [oldest] = this.pictures.keys();
      close(this.pictures.get(oldest));
      this.pictures.delete(oldest);
    }
  }
}

function close(pictures) {
  for (const picture of pictures.values()) picture.close();
}
