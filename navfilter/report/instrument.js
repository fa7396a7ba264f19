// Makes the figures of a report live: unpacks them, draws each when it comes into view, and links time, cursor and legends.
// Without it, or where it fails, the static figures stay.
"use strict";
(async () => {
  const page = document.documentElement;
  const by = (selector) => [...document.querySelectorAll(selector)];

  async function unpacked(id) {
    const text = atob(document.getElementById(id).textContent);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  const coarse = matchMedia("(pointer: coarse)").matches;
  const hidden = new Set();
  const figures = new Map(); // number -> {roots, plots, time}
  let data, shown = null, colouring = "run";

  // --- one time axis for all ---------------------------------------------------------------------------------------

  let sharing = false;
  function share(range) {
    if (sharing) return;
    sharing = true;
    shown = [range.start, range.end];
    for (const { time } of figures.values()) if (time && time !== range) time.setv({ start: range.start, end: range.end });
    for (const figure of figures.values()) if (figure.plan) part(figure);
    against();
    sharing = false;
  }

  // Rows of the run within the time that is shown; null where that is all of it.
  function within() {
    if (!shown) return null;
    const [begin, end] = data.clock.range, rows = data.rows.time.keys();
    if (shown[0] <= begin && shown[1] >= end) return null;
    return [...rows].filter((k) => data.rows.time[k] >= shown[0] && data.rows.time[k] <= shown[1]);
  }

  // The plan shows the same part: marked, and as large as fits.
  function part(figure) {
    const { root } = figure, [east] = root.select("east"), [north] = root.select("north");
    if (![east.start, east.end, north.start, north.end].every(Number.isFinite)) return;
    figure.home ??= [east.start, east.end, north.start, north.end];
    if (shown) east.have_updated_interactively = north.have_updated_interactively = true; // it would find its own extent
    const rows = within(), x = rows?.map((k) => data.rows.east[k]) ?? [], y = rows?.map((k) => data.rows.north[k]) ?? [];
    for (const glyph of root.select("zoomed")) glyph.data_source.data = { x, y };
    const [left, right, low, high] = figure.home, aspect = (right - left) / (high - low);
    if (!x.length) {
      if (rows === null) { east.setv({ start: left, end: right }); north.setv({ start: low, end: high }); }
      return;
    }
    const middle = (values) => 0.5 * (Math.min(...values) + Math.max(...values));
    const wide = (values) => Math.max(1, 1.15 * (Math.max(...values) - Math.min(...values)));
    const half = 0.5 * Math.max(wide(x), aspect * wide(y)), [across, up] = [middle(x), middle(y)];
    east.setv({ start: across - half, end: across + half });
    north.setv({ start: up - half / aspect, end: up + half / aspect });
  }

  // Any quantity against any other.
  function against() {
    const [x, y] = ["x", "y"].map((axis) => by(`select.any[data-axis=${axis}]`)[0]?.value);
    if (!x || !y) return;
    const rows = within() ?? [...data.rows.time.keys()];
    const kept = rows.filter((k) => data.rows[x][k] !== null && data.rows[y][k] !== null);
    for (const { root, any } of figures.values()) {
      if (!any.length) continue;
      const values = { x: kept.map((k) => data.rows[x][k]), y: kept.map((k) => data.rows[y][k]) };
      any[0].data_source.data = values;
      for (const plot of root.select({ type: "Figure" })) {
        plot.below.filter((axis) => "axis_label" in axis.attributes).forEach((axis) => (axis.axis_label = data.names[x]));
        plot.left.filter((axis) => "axis_label" in axis.attributes).forEach((axis) => (axis.axis_label = data.names[y]));
      }
    }
  }

  // A second axis (UTC, degrees) is offset + factor x its master.
  function follow(root, name, master) {
    const ranges = root.select(name), source = root.select(master)[0];
    if (!ranges.length || !source) return;
    const keep = () => {
      if (!Number.isFinite(source.start) || !Number.isFinite(source.end)) return;
      for (const range of ranges) {
        const [offset, factor] = range.tags;
        range.setv({ start: offset + factor * source.start, end: offset + factor * source.end });
      }
    };
    source.change.connect(keep);
    for (const side of ["start", "end"]) source.properties[side].change.connect(keep);
    keep();
  }

  // --- one cursor for all ------------------------------------------------------------------------------------------

  const readout = document.getElementById("readout");
  let due = null;
  function point(x) {
    const asked = due !== null;
    due = { x };
    if (!asked) requestAnimationFrame(() => { const { x } = due; due = null; cursor(x); });
  }

  function row(x) {
    const times = data.rows.time;
    let low = 0, high = times.length - 1;
    while (high - low > 1) { const mid = (low + high) >> 1; if (times[mid] <= x) low = mid; else high = mid; }
    return x - times[low] < times[high] - x ? low : high;
  }

  function cursor(x) {
    const on = x !== null && Number.isFinite(x);
    for (const { cursors, here } of figures.values()) {
      for (const span of cursors) span.setv(on ? { location: x, visible: true } : { visible: false });
      for (const glyph of here) {
        const k = on ? row(x) : -1;
        glyph.data_source.data = on ? { x: [data.rows.east[k]], y: [data.rows.north[k]] } : { x: [], y: [] };
      }
    }
    readout.textContent = on ? words(x) : "";
  }

  function words(x) {
    const { rows, clock } = data, k = row(x), parts = [`${x.toFixed(2)} ${clock.unit}`];
    if (clock.utc !== null) parts.push(new Date(clock.utc + (1000 * x) / clock.factor).toISOString().slice(0, 19).replace("T", " ") + " UTC");
    const place = (deg, names) => `${Math.abs(deg).toFixed(5)}° ${names[deg < 0 ? 1 : 0]}`;
    parts.push(place(rows.latitude[k], "NS"), place(rows.longitude[k], "EW"));
    parts.push(`depth ${rows.depth[k].toFixed(1)} m`, `heading ${rows.heading[k].toFixed(1)}°`, `${rows.speed[k].toFixed(2)} m/s`);
    parts.push(`predicted rms ${rows.rms[k].toPrecision(3)} m`);
    return parts.join("  ·  ");
  }

  function nearest(east, north) {
    const { rows } = data;
    let best = 0, least = Infinity;
    for (let k = 0; k < rows.time.length; k++) {
      const d = (rows.east[k] - east) ** 2 + (rows.north[k] - north) ** 2;
      if (d < least) [best, least] = [k, d];
    }
    return rows.time[best];
  }

  // --- legends -----------------------------------------------------------------------------------------------------

  function parts(plot) {
    return [...plot.renderers, ...plot.center, ...plot.left, ...plot.right, ...plot.above, ...plot.below];
  }

  function visibility(plot) {
    for (const part of parts(plot)) {
      const way = (part.tags ?? []).find((tag) => String(tag).startsWith("colour "));
      const wanted = !hidden.has(part.name) && (way === undefined || way === `colour ${colouring}`);
      if (part.name !== "cursor" && part.name !== "here" && part.name !== "zoomed" && part.name !== "any" && (part.name || way) && part.visible !== wanted) part.visible = wanted;
    }
  }

  function refresh() {
    for (const { plots } of figures.values()) plots.forEach(visibility);
    for (const key of by(".key")) key.setAttribute("aria-pressed", String(!hidden.has(key.dataset.label)));
  }

  function legend(place, keys) {
    for (const [label, hue, kind] of keys) {
      const key = document.createElement("button"), sign = document.createElement("span");
      key.type = "button";
      key.className = "key";
      key.dataset.label = label;
      key.setAttribute("aria-pressed", String(!hidden.has(label)));
      sign.className = `sign ${kind}`;
      sign.style.color = hue;
      key.append(sign, label);
      key.addEventListener("click", () => {
        if (!hidden.delete(label)) hidden.add(label);
        refresh();
      });
      place.before(key);
    }
  }

  // --- drawing -----------------------------------------------------------------------------------------------------

  async function draw(place) {
    const number = Number(place.dataset.figure), { item, keys, plan } = data.figures[number];
    const views = await Bokeh.embed.embed_item(item, place.id);
    const root = views.roots[0].model, plots = root.select({ type: "Figure" });
    const time = root.select("time")[0] ?? null;
    const cursors = root.select("cursor"), here = root.select("here");
    const any = root.select("any"), figure = { root, plots, time, cursors, here, any, plan };
    figures.set(number, figure);
    place.closest("figure").classList.add("drawn");
    legend(place.parentElement.querySelector(".keys").firstChild, keys);
    if (time) {
      if (shown) time.setv({ start: shown[0], end: shown[1] });
      for (const side of ["start", "end"]) time.properties[side].change.connect(() => share(time));
      follow(root, "utc", "time");
    }
    follow(root, "longitude", "east");
    follow(root, "latitude", "north");
    if (any.length) against();
    if (plan) setTimeout(() => part(figure), 200); // once it has been laid out
    for (const plot of plots) {
      if (coarse) plot.toolbar.active_drag = null; // a finger scrolls the page until a tool is chosen
      const events = { mouseleave: [() => point(null)] };
      if (time) events.mousemove = [(event) => point(event.x)];
      if (plan) events.mousemove = [(event) => point(nearest(event.x, event.y))];
      if (time) events.doubletap = [() => time.setv({ start: data.clock.range[0], end: data.clock.range[1] })];
      plot.js_event_callbacks = events;
      visibility(plot);
    }
    page.dataset.drawn = String(figures.size);
  }

  function start() {
    let queue = Promise.resolve();
    const watch = new IntersectionObserver((entries) => {
      for (const entry of entries.filter((each) => each.isIntersecting)) {
        watch.unobserve(entry.target);
        queue = queue.then(() => draw(entry.target)).catch((error) => {
          entry.target.closest("figure").classList.add("failed");
          console.error(error);
        });
      }
    }, { rootMargin: "300px" });
    by(".live").forEach((place) => watch.observe(place));
    for (const button of by("input[name=colouring]")) button.addEventListener("change", () => { colouring = button.value; refresh(); });
  }

  function menus() {
    for (const select of by("select.any")) {
      select.value = select.dataset.axis === "x" ? "travelled" : "rms";
      select.addEventListener("change", against);
    }
  }

  // --- one sensor at a time ----------------------------------------------------------------------------------------

  function choose(name) {
    for (const section of by("section[data-sensor]")) section.classList.toggle("chosen", section.dataset.sensor === name);
    for (const menu of by("select.sensors")) menu.value = name;
  }

  function menu() {
    const first = by("section[data-sensor]")[0];
    if (!first) return;
    choose(first.dataset.sensor);
    for (const select of by("select.sensors")) select.addEventListener("change", () => choose(select.value));
    const asked = () => {
      const section = document.getElementById(location.hash.slice(1))?.closest("section[data-sensor]");
      if (section) { choose(section.dataset.sensor); section.scrollIntoView(); }
    };
    addEventListener("hashchange", asked);
    for (const link of by("nav a")) link.addEventListener("click", () => setTimeout(asked));
    asked();
  }

  try {
    if (matchMedia("(min-width: 1100px)").matches) for (const contents of by("nav details")) contents.open = true;
    menu();
    menus();
    await new Promise((painted) => requestAnimationFrame(() => setTimeout(painted)));
    const [library, text] = await Promise.all([unpacked("library"), unpacked("figures")]);
    const script = document.createElement("script");
    script.textContent = library;
    document.head.append(script);
    data = JSON.parse(text);
    start();
  } catch (error) {
    page.classList.remove("scripted");
    console.error(error);
  }
})();
