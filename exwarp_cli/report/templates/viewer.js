// The frame viewer: one canvas, two sources, drawn from pictures that keep highlights.
(() => {
  const SLOPE = 1.055 / 2.4;
  // Bytes of decoded pictures that are kept: two sources of 144 frames of 480x270.
  const CACHED = 160e6;
  // Frames decoded ahead while playing, and frames in a row below which Play takes a longer stretch.
  const AHEAD = 6;
  const SHORT = 8;
  // Predicted error of a tile, of 255 levels, that has the map's last colour.
  const FORECAST = 64;
  // Of holes: a colour that neither renders nor, in error maps, the map has much of.
  const TINT = [230, 60, 200];
  const ERROR_TINT = [0, 190, 230];

  const toLinear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const toDisplay = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);

  // Display byte for each of the 256 codes of a picture; undoes `pictures.curve`.
  const exposureTable = (peak, stops) => {
    const table = new Uint8Array(256);
    for (let code = 0; code < 256; code++) {
      const v = (code / 255) * (1 + SLOPE * Math.log(peak));
      const linear = v <= 1 ? toLinear(v) : Math.exp((v - 1) / SLOPE);
      table[code] = Math.round(255 * toDisplay(Math.min(linear * 2 ** stops, 1)));
    }
    return table;
  };

  const heatTable = (colours) => Array.from({ length: 256 }, (_, code) => {
    const at = (code / 255) * (colours.length - 1);
    const i = Math.min(Math.floor(at), colours.length - 2);
    return colours[i].map((low, c) => Math.round(low + (at - i) * (colours[i + 1][c] - low)));
  });

  class Viewer {
    constructor(root) {
      this.root = root;
      this.data = JSON.parse(root.querySelector("script").textContent);
      this.parts = {};
      for (const part of root.querySelectorAll("[data-part]")) this.parts[part.dataset.part] = part;
      this.modes = [...root.querySelectorAll(".modes input")];
      this.heat = heatTable(this.data.heat);
      this.context = this.parts.canvas.getContext("2d", { willReadFrequently: true });
      this.decoded = new Map();
      this.held = 0;
      this.scratch = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
      this.index = 0;
      this.split = 50;
      this.asked = 0;
      this.playing = null;
    }

    start() {
      const { parts, data, root } = this;
      for (const name of ["before", "after"]) {
        for (const source of data.names) parts[name].add(new Option(source, source));
        parts[name].value = data.names.includes(data[name]) ? data[name] : data.names[0];
        parts[name].addEventListener("change", () => this.draw());
      }
      parts.seek.max = data.frames.length - 1;
      const ramp = data.heat.map((colour) => `rgb(${colour})`);
      parts.ramp.style.background = `linear-gradient(to right, ${ramp})`;
      for (const mode of this.modes) mode.addEventListener("change", () => this.draw());
      for (const name of ["holes", "exposure"]) parts[name].addEventListener("input", () => this.draw());
      parts.zoom.addEventListener("change", () => this.zoom());
      addEventListener("resize", () => this.zoom());
      parts.seek.addEventListener("input", () => this.show(Number(parts.seek.value)));
      parts.back.addEventListener("click", () => this.step(-1));
      parts.forth.addEventListener("click", () => this.step(1));
      parts.play.addEventListener("click", () => this.play());
      parts.speed.addEventListener("change", () => { if (this.playing) { this.pause(); this.play(); } });
      if (data.fps) {
        parts.speed.querySelector(`[value="${data.fps}"]`)?.remove();
        parts.speed.prepend(new Option(`${Number(data.fps.toFixed(2))} fps, real time`, data.fps));
      }
      const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
      if (data.fps || still) parts.speed.selectedIndex = still ? parts.speed.options.length - 1 : 0;
      parts.help.addEventListener("click", () => this.help());
      this.watchDivider();
      root.hidden = false;
      // Rendered frames are equal to their truth: there is more to see in the first after them.
      const first = data.frames.findIndex((frame) =>
        (data.start === null ? frame.kind !== "key" : frame.number === data.start));
      this.index = Math.max(first, 0);
      this.follow();
      addEventListener("hashchange", () => this.follow());
    }

    get mode() { return this.modes.find((input) => input.checked).value; }
    set mode(value) { this.modes.find((input) => input.value === value).checked = true; this.draw(); }
    get frame() { return this.data.frames[this.index]; }

    // The address keeps the frame: #viewer:12.
    follow() {
      const [name, number] = location.hash.slice(1).split(":");
      const found = this.data.frames.findIndex((frame) => String(frame.number) === number);
      const named = name === this.root.id && found >= 0;
      if (named && document.readyState !== "loading") this.root.scrollIntoView({ block: "nearest" });
      this.show(named ? found : this.index, false);
    }

    show(index, keep = true) {
      this.index = Math.max(0, Math.min(index, this.data.frames.length - 1));
      if (this.playing) this.pause();
      else {
        if (keep) this.keep();
        this.draw();
      }
    }

    keep() {
      // Some browsers refuse this for files; the frame is shown all the same.
      try { history.replaceState(null, "", `#${this.root.id}:${this.frame.number}`); } catch {}
    }

    step(by) { this.show(this.index + by); }

    // What is on the canvas by name, left and right.
    get sources() {
      const { before, after } = this.parts;
      return this.mode === "slider" || this.mode === "side" ? [before.value, after.value] : [before.value];
    }

    // The frames in a row around one that have all that is shown, first and last.
    stretch(index) {
      const { frames } = this.data;
      const has = (i) => this.sources.every((name) => name in frames[i].pictures);
      const joined = (i) => frames[i]?.number - frames[i - 1]?.number === 1 && has(i - 1) && has(i);
      let [first, last] = [index, index];
      while (joined(first)) first--;
      while (joined(last + 1)) last++;
      return [first, last];
    }

    // What Play takes: the stretch around the frame, or the longest one if that is short.
    playable() {
      let best = this.stretch(this.index);
      if (best[1] - best[0] + 1 >= SHORT) return best;
      for (let i = 0; i < this.data.frames.length; i = this.stretch(i)[1] + 1) {
        const [first, last] = this.stretch(i);
        if (last - first > best[1] - best[0]) best = [first, last];
      }
      return best;
    }

    // In step with the clock: frames are left out where the screen or the browser is slower.
    play() {
      if (this.playing) { this.pause(); return; }
      const [first, last] = this.playable();
      if (first === last) return;
      if (this.index < first || this.index >= last) this.index = first;
      const now = performance.now();
      const fps = Number(this.parts.speed.value);
      this.playing = { first, last, fps, start: now, from: this.index, passed: 0, since: now, drawn: 0 };
      this.tell(first, last);
      this.mark();
      this.tick(now, this.playing);
    }

    pause() {
      this.playing = null;
      this.mark();
      this.keep();
      this.draw();
    }

    mark() {
      const { play, facts } = this.parts;
      play.textContent = this.playing ? "Pause" : "Play";
      play.setAttribute("aria-pressed", String(this.playing !== null));
      // They would flicker and change the page's height.
      facts.style.visibility = this.playing ? "hidden" : "";
    }

    tell(first, last, rate = "") {
      const [a, b] = [first, last].map((i) => this.data.frames[i].number);
      this.parts.rate.textContent = first === last ? "No frames in a row to play." : `Plays frames ${a} to ${b}${rate}.`;
    }

    async tick(now, run) {
      if (run !== this.playing) return;
      const count = run.last - run.first + 1;
      const at = (passed) => run.first + ((run.from - run.first + passed) % count);
      const passed = Math.max(0, Math.floor(((now - run.start) * run.fps) / 1000));
      const by = passed - run.passed;
      if (by > 0) {
        run.passed = passed;
        run.drawn++;
        this.index = at(passed);
        for (let i = 1; i <= AHEAD; i++) {
          const { pictures } = this.data.frames[at(passed + i * by)];
          for (const name of this.sources) if (name in pictures) this.pixels(pictures[name]);
        }
        await this.draw();
      }
      if (now - run.since >= 1000 && run === this.playing) {
        const rate = (1000 * run.drawn) / (now - run.since);
        const slow = rate < 0.95 * run.fps ? ` of ${Number(run.fps.toFixed(2))}` : "";
        this.tell(run.first, run.last, `, ${Math.round(slow ? rate : run.fps)}${slow} fps`);
        Object.assign(run, { since: now, drawn: 0 });
      }
      requestAnimationFrame((then) => this.tick(then, run));
    }

    help() {
      this.parts.keys.hidden = !this.parts.keys.hidden;
      this.parts.help.setAttribute("aria-expanded", String(!this.parts.keys.hidden));
    }

    // One pixel of the frame on that many of the screen, about the middle of what is in view; 0 fits.
    zoom() {
      const { stage, sheet, canvas, zoom } = this.parts;
      const at = [stage.scrollLeft + stage.clientWidth / 2, stage.scrollTop + stage.clientHeight / 2];
      const middle = [at[0] / (sheet.offsetWidth || 1), at[1] / (sheet.offsetHeight || 1)];
      const factor = Number(zoom.value);
      sheet.style.width = factor ? `${(canvas.width * factor) / devicePixelRatio}px` : "";
      stage.parentElement.classList.toggle("enlarged", factor > 0);
      stage.scrollLeft = middle[0] * sheet.offsetWidth - stage.clientWidth / 2;
      stage.scrollTop = middle[1] * sheet.offsetHeight - stage.clientHeight / 2;
    }

    zoomBy(by) {
      const { zoom } = this.parts;
      zoom.selectedIndex = Math.max(0, Math.min(zoom.selectedIndex + by, zoom.options.length - 1));
      this.zoom();
    }

    expose(by) {
      this.parts.exposure.value = Number(this.parts.exposure.value) + by;
      this.draw();
    }

    swap() {
      const { before, after } = this.parts;
      [before.value, after.value] = [after.value, before.value];
      this.draw();
    }

    next() {
      const { before } = this.parts;
      before.selectedIndex = (before.selectedIndex + 1) % before.options.length;
      this.draw();
    }

    // The bytes of a stored picture; some stay decoded.
    async pixels(index) {
      if (!this.decoded.has(index)) {
        const image = new Image();
        image.src = this.data.images[index].url;
        const made = image.decode().then(() => {
          const { canvas } = this.scratch;
          canvas.width = image.naturalWidth;
          canvas.height = image.naturalHeight;
          this.scratch.drawImage(image, 0, 0);
          return this.scratch.getImageData(0, 0, canvas.width, canvas.height);
        });
        const bytes = (i) => 4 * this.data.images[i].width * this.data.images[i].height;
        this.decoded.set(index, made);
        this.held += bytes(index);
        for (const oldest of this.decoded.keys()) {
          if (this.held <= CACHED) break;
          this.decoded.delete(oldest);
          this.held -= bytes(oldest);
        }
      }
      return this.decoded.get(index);
    }

    // A source of the frame on display, RGBA; null where the frame lacks it.
    async shown(name, stops) {
      const index = this.frame.pictures[name];
      if (index === undefined) return null;
      const stored = await this.pixels(index);
      const table = exposureTable(this.data.images[index].peak, stops);
      const out = new ImageData(stored.width, stored.height);
      for (let i = 0; i < out.data.length; i += 4) {
        for (let c = 0; c < 3; c++) out.data[i + c] = table[stored.data[i + c]];
        out.data[i + 3] = 255;
      }
      return out;
    }

    // The stored error of one of the two, else how far they are apart on the display.
    async error(names, pair) {
      const found = names.find((name) => this.frame.errors[name] !== undefined);
      let codes, tag;
      if (found !== undefined) {
        codes = await this.pixels(this.frame.errors[found]);
        tag = `error of ${found}`;
      } else {
        if (!pair[0] || !pair[1]) return [null, "error"];
        codes = new ImageData(pair[0].width, pair[0].height);
        for (let i = 0; i < codes.data.length; i += 4) {
          let sum = 0;
          for (let c = 0; c < 3; c++) sum += Math.abs(pair[0].data[i + c] - pair[1].data[i + c]);
          codes.data[i] = Math.round(255 * Math.sqrt(sum / 765));
        }
        tag = `${names[0]} against ${names[1]}`;
      }
      const out = new ImageData(codes.width, codes.height);
      for (let i = 0; i < out.data.length; i += 4) {
        out.data.set(this.heat[codes.data[i]], i);
        out.data[i + 3] = 255;
      }
      return [out, tag];
    }

    // The predicted error of the frame's tiles over its grey picture, in the error map's colours.
    forecast(image) {
      const risk = this.frame.risk;
      if (!image || risk === null) return null;
      const { width, height } = image;
      for (let y = 0; y < height; y++) {
        const row = Math.floor((y * risk.rows) / height) * risk.columns;
        for (let x = 0; x < width; x++) {
          const level = risk.levels[row + Math.floor((x * risk.columns) / width)];
          const tint = this.heat[Math.round(255 * Math.sqrt(Math.min(level / FORECAST, 1)))];
          const at = 4 * (y * width + x);
          const grey = (image.data[at] + image.data[at + 1] + image.data[at + 2]) / 3;
          for (let c = 0; c < 3; c++) image.data[at + c] = 0.3 * grey + 0.7 * tint[c];
        }
      }
      return image;
    }

    async tint(image) {
      if (!image || !this.parts.holes.checked || this.frame.holes === null) return image;
      const mask = await this.pixels(this.frame.holes);
      const tint = this.mode === "error" ? ERROR_TINT : TINT;
      const { width, height } = image;
      for (let i = 0; i < image.data.length; i += 4) {
        const x = Math.floor((((i / 4) % width) * mask.width) / width);
        const y = Math.floor((Math.floor(i / 4 / width) * mask.height) / height);
        if (mask.data[4 * (y * mask.width + x)] < 128) continue;
        for (let c = 0; c < 3; c++) image.data[i + c] = (image.data[i + c] + 2 * tint[c]) / 3;
      }
      return image;
    }

    async draw() {
      const turn = ++this.asked;
      const { parts, mode } = this;
      const names = [parts.before.value, parts.after.value];
      const stops = Number(parts.exposure.value);
      let pair = await Promise.all((mode === "single" ? [names[0]] : names).map((name) => this.shown(name, stops)));
      let tags = names;
      if (mode === "error") {
        const [image, text] = await this.error(names, pair);
        pair = [image, image];
        tags = [text, ""];
      }
      if (mode === "forecast") {
        const image = this.forecast(pair.find(Boolean) ?? null);
        pair = [image, image];
        tags = ["predicted error", ""];
      }
      pair = [await this.tint(pair[0]), pair[0] === pair[1] ? pair[0] : await this.tint(pair[1])];
      if (turn !== this.asked) return;
      this.paint(pair, mode);
      this.label(pair, tags, mode, stops);
    }

    paint([left, right], mode) {
      const { canvas } = this.parts;
      const size = left || right || { width: canvas.width, height: canvas.height };
      const gap = 4;
      const width = mode === "side" ? 2 * size.width + gap : size.width;
      if (canvas.width !== width || canvas.height !== size.height) {
        canvas.width = width;
        canvas.height = size.height;
        this.zoom();
      }
      this.context.fillStyle = "#000";
      this.context.fillRect(0, 0, width, size.height);
      this.drawn = { left, right, mode };
      if (mode === "side") {
        if (left) this.context.putImageData(left, 0, 0);
        if (right) this.context.putImageData(right, size.width + gap, 0);
      } else if (mode === "slider") this.paintSplit();
      else if (left) this.context.putImageData(left, 0, 0);
    }

    paintSplit() {
      const { left, right } = this.drawn;
      const { width, height } = this.parts.canvas;
      const at = Math.round((width * this.split) / 100);
      this.context.fillRect(0, 0, width, height);
      if (left) this.context.putImageData(left, 0, 0, 0, 0, at, height);
      if (right) this.context.putImageData(right, 0, 0, at, 0, width - at, height);
    }

    label(pair, tags, mode, stops) {
      const { parts, frame, root } = this;
      const name = (i) => tags[i] + (pair[i] ? "" : " (not in this frame)");
      parts["left-tag"].textContent = name(0);
      parts["right-tag"].textContent = mode === "slider" || mode === "side" ? name(1) : "";
      parts["right-tag"].hidden = parts["right-tag"].textContent === "";
      parts.divider.hidden = mode !== "slider";
      parts.legend.hidden = mode !== "error" && mode !== "forecast";
      parts.stops.textContent = (stops > 0 ? "+" : "") + stops;
      parts.seek.value = this.index;
      parts.seek.setAttribute("aria-valuetext", frame.label);
      parts.canvas.setAttribute("aria-label", `${frame.label}: ${tags.filter(Boolean).join(" and ")}`);
      parts.scale.textContent = mode === "forecast" ? `${FORECAST} of 255 levels, by square root`
        : "100 % of the display range, by square root";
      const forecast = this.modes.find((input) => input.value === "forecast");
      forecast.disabled = !this.data.frames.some((one) => one.risk !== null);
      parts.holes.disabled = !this.data.frames.some((one) => one.holes !== null);
      Object.assign(root.dataset, { frame: frame.number, mode, drawn: this.asked });
      if (this.playing) return;
      this.tell(...this.playable());
      const facts = Object.entries({ [frame.label]: frame.kind, ...frame.facts });
      parts.facts.replaceChildren(...facts.map(([term, text]) => {
        const pairOf = document.createElement("div");
        pairOf.append(document.createElement("dt"), document.createElement("dd"));
        pairOf.firstChild.textContent = term;
        pairOf.lastChild.textContent = text;
        return pairOf;
      }));
    }

    divide(percent) {
      this.split = Math.max(0, Math.min(percent, 100));
      this.parts.divider.style.left = `${this.split}%`;
      this.parts.divider.setAttribute("aria-valuenow", String(Math.round(this.split)));
      if (this.drawn?.mode === "slider") this.paintSplit();
    }

    watchDivider() {
      const { sheet, divider } = this.parts;
      let held = false;
      const move = (event) => {
        const box = sheet.getBoundingClientRect();
        this.divide((100 * (event.clientX - box.left)) / box.width);
      };
      sheet.addEventListener("pointerdown", (event) => {
        // A touch beside the handle scrolls the page.
        if (this.mode !== "slider" || (event.pointerType === "touch" && event.target !== divider)) return;
        held = true;
        sheet.setPointerCapture(event.pointerId);
        divider.focus({ preventScroll: true });
        event.preventDefault();
        move(event);
      });
      sheet.addEventListener("pointermove", (event) => { if (held) move(event); });
      for (const end of ["pointerup", "pointercancel"]) sheet.addEventListener(end, () => { held = false; });
      divider.addEventListener("keydown", (event) => {
        const by = event.shiftKey ? 10 : 2;
        const to = { ArrowLeft: this.split - by, ArrowRight: this.split + by, Home: 0, End: 100 }[event.key];
        if (to === undefined) return;
        this.divide(to);
        event.preventDefault();
        event.stopPropagation();
      });
    }

    // Returns whether the key meant something here.
    key(event) {
      const own = {
        ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
        j: () => this.step(-1), k: () => this.step(1),
        Home: () => this.show(0), End: () => this.show(this.data.frames.length - 1),
        " ": () => this.play(), "?": () => this.help(), x: () => this.swap(), c: () => this.next(),
        h: () => { this.parts.holes.checked = !this.parts.holes.checked; this.draw(); },
        e: () => this.expose(-0.5), E: () => this.expose(0.5),
        z: () => this.zoomBy(1), Z: () => this.zoomBy(-1),
      };
      this.modes.forEach((input, i) => { own[i + 1] = () => { if (!input.disabled) this.mode = input.value; }; });
      if (!Object.hasOwn(own, event.key)) return false;
      own[event.key]();
      return true;
    }
  }

  const viewers = [...document.querySelectorAll(".viewer")].map((root) => new Viewer(root));
  let current = viewers[0];
  for (const viewer of viewers) {
    viewer.start();
    for (const what of ["pointerdown", "focusin"]) {
      viewer.root.addEventListener(what, () => { current = viewer; });
    }
  }
  document.addEventListener("keydown", (event) => {
    if (!current || event.ctrlKey || event.altKey || event.metaKey) return;
    const control = event.target.closest?.("input, select, button, a, [role=slider], .table, .wide");
    // Fields, buttons and scrolling boxes keep the keys that they use themselves.
    const theirs = control && (control.tagName === "SELECT" || !/^[a-zA-Z1-5?]$/.test(event.key));
    if (!theirs && current.key(event)) event.preventDefault();
  });
})();
