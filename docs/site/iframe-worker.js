/* The worker of the search, in a frame: from file: a browser starts no Worker. */
if (location.protocol === "file:") {
  /** @typedef {Window & {importScripts: (...scripts: string[]) => Promise<unknown>}} Inside */

  const FrameWorker = class extends EventTarget {
    /** @param {string} url */
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      /** @type {unknown[]} */
      this.waiting = [];
      /** @type {?Window} */
      this.inside = null;
      document.body.append(frame);
      const inside = /** @type {Inside} */ (frame.contentWindow);
      inside.document.open();
      inside.document.close();
      // What the script says goes to this page; what it imports is loaded before it goes on.
      inside.postMessage = (/** @type {unknown} */ data) => this.dispatchEvent(new MessageEvent("message", { data }));
      inside.importScripts = (...scripts) =>
        scripts.reduce(
          (before, script) => before.then(() => load(inside, script)),
          /** @type {Promise<unknown>} */ (Promise.resolve()),
        );
      load(inside, url).then(() => {
        this.inside = inside;
        this.waiting.splice(0).forEach((data) => this.postMessage(data));
      });
    }

    /** @param {unknown} data */
    postMessage(data) {
      if (this.inside) this.inside.dispatchEvent(new MessageEvent("message", { data }));
      else this.waiting.push(data);
    }
  };
  Object.assign(window, { Worker: FrameWorker });

  /** @param {Window} inside @param {string} url */
  const load = (inside, url) =>
    new Promise((loaded, failed) => {
      const script = inside.document.createElement("script");
      script.src = url;
      script.onload = loaded;
      script.onerror = failed;
      inside.document.body.append(script);
    });
}
