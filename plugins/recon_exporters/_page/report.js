// The page is complete without this script, which adds: values under the pointer in all charts and on the map, a closer
// look by dragging sideways, both by keys as well, and a street map behind the track where the page comes from a web server.
"use strict";
(() => {
  const LEFT = 62, TOP = 6, RIGHT = 948, BOTTOM = 134, COLUMNS = 30000, ROWS = 10000;
  const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400];
  const SVG = "http://www.w3.org/2000/svg";
  const make = (name, facts, parent) => {
    const node = document.createElementNS(SVG, name);
    for (const key in facts) node.setAttribute(key, facts[key]);
    if (parent) parent.appendChild(node);
    return node;
  };
  const numbers = text => text.split(" ").map(Number);

  // ---- charts
  const points = path => {
    if (!path.points) {
      path.points = (path.getAttribute("d").match(/-?[\d.]+ -?[\d.]+/g) || []).map(numbers);
    }
    return path.points;
  };
  const nearest = (list, x, at) => {
    let low = 0, high = list.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (at(list[middle]) < x) low = middle; else high = middle;
    }
    return Math.abs(at(list[low]) - x) <= Math.abs(at(list[high]) - x) ? low : high;
  };
  const clock = (t, step) => {
    if (Math.abs(t) < 600 && step < 60) return `${+t.toFixed(6)} s`.replace("-", "−");
    const whole = Math.abs(Math.round(t)), two = n => String(n).padStart(2, "0");
    const minutes = Math.floor(whole / 60), hours = Math.floor(minutes / 60);
    return (t < 0 ? "−" : "") + (hours ? `${hours}:${two(minutes % 60)}` : minutes) + ":" + two(whole % 60);
  };
  const stepOf = span => {
    if (span > 9) return STEPS.find(step => span / step <= 9) || 28800;
    const size = 10 ** Math.floor(Math.log10(span / 9));
    return [1, 2, 2.5, 5, 10].map(step => step * size).find(step => span / step <= 9);
  };
  const digits = panel => {
    const [low, high] = panel.y;
    return Math.max(0, 3 - Math.floor(Math.log10(high - low)));
  };

  const panelsOf = group => [...group.querySelectorAll(".panel")].map(figure => {
    const svg = figure.querySelector(":scope > svg");
    const panel = {
      figure, svg, output: figure.querySelector("output"), data: svg.querySelector(".data"),
      times: svg.querySelector(".times"), t: numbers(figure.dataset.t), y: numbers(figure.dataset.y),
      curves: [...svg.querySelectorAll(".curve")],
    };
    panel.cursor = make("path", {class: "cursor", visibility: "hidden"}, svg);
    panel.chosen = make("rect", {class: "chosen", y: TOP, height: BOTTOM - TOP, visibility: "hidden"}, svg);
    return panel;
  });

  const show = (group, first, last) => {
    for (const panel of group.panels) {
      const [begin, end] = panel.t, left = (first - begin) / (end - begin) * COLUMNS;
      const width = Math.max((last - first) / (end - begin) * COLUMNS, 1);
      panel.data.setAttribute("viewBox", `${left} 0 ${width} ${ROWS}`);
      panel.times.replaceChildren();
      const step = stepOf(last - first);
      for (let n = Math.ceil(first / step - 1e-9); n * step <= last + 1e-9 * step; n++) {
        const x = LEFT + (n * step - first) / (last - first) * (RIGHT - LEFT);
        make("path", {class: "grid", d: `M${x} ${TOP}V${BOTTOM}`}, panel.times);
        make("text", {class: "time", x, y: BOTTOM + 16}, panel.times).textContent = clock(n * step, step);
      }
    }
    group.shown = [first, last];
  };

  const read = (group, t) => {
    const [first, last] = group.shown, x = LEFT + (t - first) / (last - first) * (RIGHT - LEFT);
    for (const panel of group.panels) {
      panel.cursor.setAttribute("d", `M${x} ${TOP}V${BOTTOM}`);
      panel.cursor.setAttribute("visibility", "visible");
      const [begin, end] = panel.t, [low, high] = panel.y, column = (t - begin) / (end - begin) * COLUMNS;
      const told = panel.curves.map(path => {
        const list = points(path);
        if (!list.length) return "";
        const [there, row] = list[nearest(list, column, point => point[0])];
        if (Math.abs(there - column) * (end - begin) / COLUMNS > Math.max(1, (last - first) / 100)) return "";
        let value = high - row / ROWS * (high - low);
        if (panel.figure.dataset.circular) value = (value % 360 + 360) % 360;
        return `${path.dataset.name} ${value.toFixed(digits(panel))}`;
      });
      panel.output.textContent = [`${t.toFixed(2)} s`, ...told.filter(Boolean)].join("   ");
    }
    mark(t);
  };

  const clear = group => {
    for (const panel of group.panels) {
      panel.cursor.setAttribute("visibility", "hidden");
      panel.output.textContent = "";
    }
    mark(null);
  };

  const listen = (group, panel) => {
    let from = null;
    const place = event => {
      const box = panel.svg.getBoundingClientRect(), x = (event.clientX - box.left) / box.width * 1000;
      return Math.min(Math.max(x, LEFT), RIGHT);
    };
    const time = x => {
      const [first, last] = group.shown;
      return first + (x - LEFT) / (RIGHT - LEFT) * (last - first);
    };
    panel.svg.addEventListener("pointerdown", event => {
      if (event.button) return;
      from = place(event);
      panel.svg.setPointerCapture(event.pointerId);
    });
    panel.svg.addEventListener("pointermove", event => {
      const x = place(event);
      read(group, time(x));
      if (from === null) return;
      const facts = {x: Math.min(x, from), width: Math.abs(x - from), visibility: "visible"};
      for (const key in facts) panel.chosen.setAttribute(key, facts[key]);
    });
    panel.svg.addEventListener("pointerup", event => {
      const [a, b] = [from, place(event)].sort((p, q) => p - q);
      panel.chosen.setAttribute("visibility", "hidden");
      if (from !== null && b - a > 8) show(group, time(a), time(b));
      from = null;
    });
    panel.svg.addEventListener("pointercancel", () => {
      panel.chosen.setAttribute("visibility", "hidden");
      from = null;
    });
    panel.svg.addEventListener("dblclick", () => show(group, ...panel.t));
    panel.svg.addEventListener("pointerleave", () => clear(group));
  };

  const steer = (group, panel) => {
    const [begin, end] = panel.t, within = (t, low, high) => Math.min(Math.max(t, low), high);
    let at = null;
    const look = width => {  // so much time, with the place of the cursor in it
      const wide = Math.min(width, end - begin), first = within(at - wide / 2, begin, end - wide);
      show(group, first, first + wide);
    };
    panel.svg.tabIndex = 0;
    panel.svg.addEventListener("keydown", event => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      const [first, last] = group.shown, span = last - first, step = span / (event.shiftKey ? 10 : 100);
      if (at === null || at < first || at > last) at = (first + last) / 2;
      const to = {ArrowLeft: at - step, ArrowRight: at + step, Home: begin, End: end}[event.key];
      if (to !== undefined) {
        at = within(to, begin, end);
        if (at < first || at > last) look(span);
      } else if ("+=".includes(event.key)) look(span / 2);
      else if (event.key === "-") look(span * 2);
      else if (event.key === "Escape") look(Infinity);
      else return;
      event.preventDefault();
      read(group, at);
    });
    panel.svg.addEventListener("blur", () => clear(group));
  };

  // ---- map
  const map = document.querySelector(".map"), track = map && map.querySelector("[data-t]");
  const now = map && map.querySelector(".now");
  const moments = track ? numbers(track.dataset.t) : [];
  const mark = t => {
    if (!now) return;
    now.setAttribute("visibility", t === null || !moments.length ? "hidden" : "visible");
    if (t === null || !moments.length) return;
    const [x, y] = points(track)[nearest(moments, t * 1000, moment => moment)];
    now.setAttribute("cx", x);
    now.setAttribute("cy", y);
  };

  const streets = () => {
    const [x0, y0, unit] = numbers(map.dataset.world), svg = map.querySelector(":scope > svg");
    const {width, height} = svg.viewBox.baseVal, tiles = map.querySelector(".tiles");
    const zoom = Math.min(19, Math.max(0, Math.round(Math.log2(1 / (256 * unit))))), count = 2 ** zoom;
    const size = 1 / (count * unit);
    for (let column = Math.floor(x0 * count); (column / count - x0) / unit < width; column++) {
      for (let row = Math.max(0, Math.floor(y0 * count)); (row / count - y0) / unit < height && row < count; row++) {
        make("image", {
          href: `https://tile.openstreetmap.org/${zoom}/${(column % count + count) % count}/${row}.png`,
          x: (column / count - x0) / unit, y: (row / count - y0) / unit, width: size, height: size,
        }, tiles);
      }
    }
  };
  if (map && map.dataset.world && location.protocol.startsWith("http")) {
    const told = document.createElement("p"), box = document.createElement("input"), label = document.createElement("label");
    told.className = "hint";
    box.type = "checkbox";
    box.addEventListener("change", () => box.checked ? streets() : map.querySelector(".tiles").replaceChildren());
    label.append(box, " street map behind the track: asks tile.openstreetmap.org for it; ");
    const source = document.createElement("a");
    source.href = "https://www.openstreetmap.org/copyright";
    source.textContent = "© OpenStreetMap contributors";
    told.append(label, source);
    map.append(told);
  }

  for (const node of document.querySelectorAll(".charts")) {
    const group = {panels: panelsOf(node)};
    if (!group.panels.length) continue;
    group.shown = group.panels[0].t;
    for (const panel of group.panels) {
      listen(group, panel);
      steer(group, panel);
    }
    const hint = document.createElement("p");
    hint.className = "hint screen";
    hint.textContent = matchMedia("(max-width: 700px)").matches
      ? "Charts and tables go on where their edge is dark: slide them sideways."
      : "Point at a chart to read values, drag sideways to look closer, double-click for the whole; "
        + "or Tab to it: arrows, + and −, Esc.";
    node.prepend(hint);
  }
  document.documentElement.dataset.ready = "1";
})();
