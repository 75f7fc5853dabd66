// Draws the figures of a page as they come into sight: JSON in, SVG out. Nothing is fetched.
(function () {
  "use strict";
  var NARROW = 560;
  var darkOf = JSON.parse(document.getElementById("dark-colours").textContent);
  var prefersDark = window.matchMedia("(prefers-color-scheme: dark)");
  var coarse = window.matchMedia("(pointer: coarse)").matches;
  var printing = false;
  var figures = new Map(); // element -> {given, drawn}
  var stored = {}; // what they hold, by identifier
  var ranges = {}; // what is looked at, by group of linked time axes
  var strips = {}; // what an autopilot said, by the same group
  document.querySelectorAll("script[data-strip]").forEach(function (script) {
    strips[script.dataset.strip] = JSON.parse(script.textContent);
  });

  // ---- what a figure holds

  function bytesOf(text) {
    var raw = atob(text), bytes = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    return bytes;
  }

  function floats(packed) {
    if (Array.isArray(packed)) return packed;
    if (!packed || !packed.bdata) return packed;
    var raw = bytesOf(packed.bdata).buffer;
    if (packed.dtype === "f4") return Array.from(new Float32Array(raw), function (v) { return v === v ? v : null; });
    return Array.from(new Uint16Array(raw), function (v) { return v ? packed.low + (v - 1) * packed.step : null; });
  }

  function given(div) {
    var figure = figures.get(div);
    if (!figure.given) {
      figure.given = stored[div.id];
      (figure.given.data || []).forEach(function (trace) { trace.x = floats(trace.x); trace.y = floats(trace.y); });
    }
    return figure.given;
  }

  function colour(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }

  function recoloured(value) {
    if (typeof value === "string") return darkOf[value] || value;
    if (Array.isArray(value)) return value.length > 60 ? value : value.map(recoloured);
    if (value === null || typeof value !== "object") return value;
    return Object.fromEntries(Object.entries(value).map(function (e) {
      return [e[0], e[0] === "x" || e[0] === "y" ? e[1] : recoloured(e[1])];
    }));
  }

  function isAxis(key) { return /^[xy]axis\d*$/.test(key); }

  // ---- plots

  function dressed(div) {
    var f = given(div), dark = prefersDark.matches && !printing, narrow = div.clientWidth < NARROW;
    var copy = { data: f.data.map(function (t) { return Object.assign({}, t); }), layout: JSON.parse(JSON.stringify(f.layout)) };
    if (dark) copy = recoloured(copy);
    var layout = copy.layout, ink = colour("--ink"), dim = colour("--dim"), grid = colour("--grid"), line = colour("--line");
    layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
    layout.font = { family: "system-ui, 'Segoe UI', sans-serif", size: narrow ? 10.5 : 12, color: ink };
    layout.showlegend = false;
    layout.autosize = true;
    layout.hoverlabel = { align: "left" };
    if (coarse) layout.dragmode = false;
    layout.margin = Object.assign({ l: 78, r: 14, t: 20, b: 44 }, layout.margin);
    if (narrow) { layout.margin.l = 58; layout.margin.r = 10; }
    Object.keys(layout).filter(isAxis).forEach(function (key) {
      var axis = layout[key];
      Object.assign(axis, { showline: true, linecolor: line, gridcolor: grid, zerolinecolor: line, tickcolor: line, automargin: true });
      if (axis.title) axis.title = Object.assign({ standoff: narrow ? 4 : 8 }, axis.title, { font: { size: narrow ? 10 : 11.5, color: ink } });
      axis.tickfont = { color: dim, size: narrow ? 9.5 : 11 };
      if (key[0] === "x" && narrow) axis.nticks = 5;
    });
    (layout.annotations || []).forEach(function (a) {
      a.font = { size: narrow ? 9.5 : 11, color: dim };
      if (!a.name) return; // the share of the axis that its span takes
      a.visible = parseFloat(a.name) * (div.clientWidth - layout.margin.l - layout.margin.r) > 6.2 * a.text.length + 4;
    });
    var seen = ranges[(f.layout.meta || {}).time];
    if (seen) Object.keys(layout).filter(function (k) { return /^xaxis/.test(k); }).forEach(function (k) {
      layout[k].range = seen.slice(); layout[k].autorange = false;
    });
    if (moment !== null && covers(f, moment)) (layout.shapes = layout.shapes || []).push({ type: "line", xref: "x", yref: "paper",
      x0: moment, x1: moment, y0: 0, y1: 1, line: { width: 2, color: colour("--accent") } });
    var strip = strips[(f.layout.meta || {}).time], power = (f.layout.meta || {}).spectrogram;
    if (strip) stripped(copy, strip, dark, div.clientWidth - layout.margin.l - layout.margin.r);
    if (power) layout.images = [{ source: painted(power, dark), xref: "x", yref: "y", x: power.start, y: power.top,
      sizex: power.end - power.start, sizey: power.top, sizing: "stretch", layer: "below" }];
    var hidden = hiddenOf(div);
    copy.data.forEach(function (t) { if (hidden.has(keyOf(t))) t.visible = false; });
    return copy;
  }

  // ---- modes, failsafes and messages over a figure: a strip of its own above the panels

  var MARKS = { // symbol, colour on a light page, on a dark one
    armed: ["triangle-right", "#2f8f5b", "#54c98a"], disarmed: ["square", "#2f8f5b", "#54c98a"],
    grave: ["diamond", "#c23b66", "#f27a9f"], said: ["circle", "#6b7280", "#a3abb7"]
  };

  function stripped(copy, strip, dark, width) {
    var layout = copy.layout, top = layout.margin.t, below = layout.height - top - layout.margin.b;
    var full = below + strip.height, low = 1 - (strip.height - 5) / full, shapes = layout.shapes = layout.shapes || [];
    var along = (layout.xaxis.range || [0, 1]).map(Number), red = MARKS.grave[dark ? 2 : 1], names = [];
    layout.height += strip.height;
    Object.keys(layout).filter(function (k) { return /^yaxis\d*$/.test(k); }).forEach(function (k) {
      layout[k].domain = layout[k].domain.map(function (d) { return d * below / full; });
    });
    layout.yaxis99 = { anchor: "x", domain: [low, 1], range: [0, 1], fixedrange: true, visible: false };
    strip.modes.forEach(function (m) {
      if (names.indexOf(m[0]) < 0) names.push(m[0]);
      shapes.push({ type: "rect", xref: "x", yref: "paper", x0: m[1], x1: m[2], y0: low, y1: 1, layer: "below",
        fillcolor: names.indexOf(m[0]) % 2 ? "#7f8fb0" : "#8fa6c9", opacity: 0.35, line: { width: 1, color: dark ? "#14171b" : "#ffffff" } });
      var text = m[0], share = (Math.min(m[2], along[1]) - Math.max(m[1], along[0])) / (along[1] - along[0]);
      (layout.annotations = layout.annotations || []).push({ text: text, xref: "x", yref: "paper", y: (low + 1) / 2, showarrow: false, yanchor: "middle",
        x: (Math.min(m[2], along[1]) + Math.max(m[1], along[0])) / 2, font: { size: 10, color: colour("--ink") },
        visible: share * width > 6.2 * text.length + 4 });
    });
    strip.failsafes.forEach(function (s) {
      shapes.push({ type: "rect", xref: "x", yref: "paper", x0: s[1], x1: s[2], y0: 0, y1: 1, layer: "below",
        fillcolor: red, opacity: 0.14, line: { width: 0 } });
    });
    var lines = strip.marks.filter(function (m) { return m[1] !== "said"; });
    if (lines.length <= 12) lines.forEach(function (m) { // more would hide the curves
      shapes.push({ type: "line", xref: "x", yref: "paper", x0: m[0], x1: m[0], y0: 0, y1: low, layer: "below",
        line: { width: 1, dash: "dot", color: MARKS[m[1]][dark ? 2 : 1] } });
    });
    var all = strip.marks.concat(strip.failsafes.map(function (s) { return [s[1], "grave", s[0]]; }));
    copy.data.push({ type: "scatter", mode: "markers", xaxis: "x", yaxis: "y99", showlegend: false, cliponaxis: false,
      x: all.map(function (m) { return m[0]; }), y: all.map(function () { return 0.12; }),
      text: all.map(function (m) { return m[2]; }), hovertemplate: "%{text} at %{x:.2f} s<extra></extra>",
      marker: { size: 6, symbol: all.map(function (m) { return MARKS[m[1]][0]; }),
        color: all.map(function (m) { return MARKS[m[1]][dark ? 2 : 1]; }) } });
  }

  // ---- spectrograms: a byte a cell, 0 where nothing is known

  var POWER = [[255, 255, 255], [199, 221, 244], [110, 163, 222], [39, 98, 184], [9, 32, 88]];
  var POWER_DARK = [[24, 28, 34], [27, 52, 92], [40, 98, 176], [116, 170, 230], [232, 243, 255]];

  function cells(power) {
    return bytesOf(power.cells);
  }

  function painted(power, dark) {
    var canvas = document.createElement("canvas"), given = cells(power), steps = dark ? POWER_DARK : POWER;
    canvas.width = power.columns; canvas.height = power.rows;
    var pen = canvas.getContext("2d"), picture = pen.createImageData(power.columns, power.rows);
    for (var row = 0; row < power.rows; row++) for (var column = 0; column < power.columns; column++) {
      var value = given[row * power.columns + column], at = 4 * ((power.rows - 1 - row) * power.columns + column);
      var share = Math.max(0, value - 1) / 254 * (steps.length - 1), k = Math.min(Math.floor(share), steps.length - 2);
      for (var c = 0; c < 3; c++) picture.data[at + c] = steps[k][c] + (share - k) * (steps[k + 1][c] - steps[k][c]);
      picture.data[at + 3] = value ? 255 : 0;
    }
    pen.putImageData(picture, 0, 0);
    return canvas.toDataURL("image/png");
  }

  var together = {}; // what is hidden, by group of figures whose keys go together

  function hiddenOf(div) {
    var figure = figures.get(div), group = figure.scene ? null : (given(div).layout.meta || {}).keys;
    if (!group) return figure.hidden;
    return together[group] = together[group] || new Set();
  }

  function toggle(div, key) { // here, and where keys go along
    var hidden = hiddenOf(div);
    if (hidden.has(key)) hidden.delete(key); else hidden.add(key);
    figures.forEach(function (other, there) {
      if (!other.drawn || other.scene || hiddenOf(there) !== hidden) return;
      there.parentNode.querySelectorAll(".key").forEach(function (b) {
        if (b.dataset.key === key) b.setAttribute("aria-pressed", String(!hidden.has(key)));
      });
      draw(there);
    });
  }

  function keyOf(trace) { return trace.legendgroup || trace.name || ""; }

  function draw(div) {
    var figure = figures.get(div);
    if (figure.scene) { if (!figure.drawn) scene(div, figure); figure.drawn = true; return; }
    var f = dressed(div);
    Plotly.react(div, f.data, f.layout, { responsive: true, displaylogo: false, displayModeBar: false });
    if (figure.drawn) return;
    figure.drawn = true;
    keys(div, f);
    var group = (f.layout.meta || {}).time;
    if (!group) return;
    div.on("plotly_click", function (event) {
      moment = event.points[0].x;
      history.replaceState(null, "", "#t=" + moment.toFixed(2));
      figures.forEach(function (other, there) { if (other.drawn && !other.scene && covers(given(there), moment)) draw(there); });
    });
    div.on("plotly_relayout", function (event) {
      var range = null, found = false;
      Object.keys(event).forEach(function (k) {
        if (/^xaxis\d*\.range\[0\]$/.test(k)) { range = [event[k], event[k.replace("[0]", "[1]")]]; found = true; }
        else if (/^xaxis\d*\.range$/.test(k)) { range = event[k]; found = true; }
        else if (/^xaxis\d*\.autorange$/.test(k) && !found) found = true;
      });
      if (!found || String(range) === String(ranges[group] || null)) return;
      if (range) ranges[group] = range; else delete ranges[group];
      figures.forEach(function (other, there) {
        if (there === div || !other.drawn || other.scene || (given(there).layout.meta || {}).time !== group) return;
        draw(there);
      });
    });
  }

  // ---- a moment of the flight: #t=12.3 in the address, and the address of a moment that is clicked

  var moment = null, MOMENT_S = 5; // shown before and after it

  function covers(f, t) { // whether a figure shows time, and this one
    var range = f.layout.xaxis && f.layout.xaxis.range;
    return Boolean((f.layout.meta || {}).time && range && range[0] <= t && t <= range[1]);
  }

  function goToMoment() {
    var asked = /^#t=(\d+(?:\.\d+)?)$/.exec(location.hash), first = null;
    if (!asked) return;
    moment = Number(asked[1]);
    figures.forEach(function (figure, div) {
      if (figure.scene || !covers(given(div), moment)) return;
      first = first || div;
      look(div, [moment - MOMENT_S, moment + MOMENT_S]);
    });
    if (!first) return;
    draw(first);
    first.focus({ preventScroll: true });
    first.scrollIntoView({ block: "center" });
  }

  function look(div, range) { // at a span of time; null: at all of it
    var group = (given(div).layout.meta || {}).time;
    if (group && range) ranges[group] = range; else if (group) delete ranges[group];
    figures.forEach(function (other, there) {
      if (other.scene || !other.drawn) return;
      if (there !== div && (!group || (given(there).layout.meta || {}).time !== group)) return;
      if (range) draw(there);
      else { // a new plot forgets what was zoomed
        Plotly.purge(there); other.drawn = false;
        there.parentNode.querySelectorAll(".keys").forEach(function (k) { k.replaceChildren(); });
        draw(there);
      }
    });
  }

  // ---- keys and buttons of a figure

  function button(text, title, action) {
    var b = document.createElement("button");
    b.type = "button"; b.textContent = text; b.title = title;
    b.setAttribute("aria-label", title);
    b.addEventListener("click", action);
    return b;
  }

  function keys(div, f) {
    var place = div.parentNode.querySelector(".keys"), seen = new Set();
    place.replaceChildren();
    f.data.forEach(function (trace) {
      var key = keyOf(trace);
      if (!trace.name || trace.showlegend === false || seen.has(key)) return;
      seen.add(key);
      var line = trace.line || {}, marker = trace.marker || {}, shade = trace.fillcolor && !line.width;
      var b = button(trace.name, "show or hide " + trace.name, function () { toggle(div, key); });
      b.className = "key";
      b.dataset.key = key;
      b.setAttribute("aria-pressed", String(!hiddenOf(div).has(key)));
      var swatch = document.createElement("i");
      var style = shade ? "block" : { dash: "dashed", dot: "dotted" }[line.dash] || "solid";
      if (trace.mode === "markers") style = "round";
      swatch.className = style;
      swatch.dataset.colour = (shade ? trace.fillcolor : line.color || marker.color) || "#8a8f98";
      swatch.style.color = swatch.dataset.colour;
      b.prepend(swatch);
      place.append(b);
    });
    tools(div, place);
  }

  function tools(div, place) {
    var span = document.createElement("span"), label = div.getAttribute("aria-label");
    span.className = "tools";
    if (!figures.get(div).scene) {
      span.append(button("reset", "reset the zoom of " + label, function () { look(div, null); }),
                  button("PNG", "save as PNG: " + label, function () { image(div, "png"); }),
                  button("SVG", "save as SVG: " + label, function () { image(div, "svg"); }));
    }
    span.append(button("CSV", "save the numbers as CSV: " + label, function () { save(div.id + ".csv", "text/csv", csv(div)); }));
    place.append(span);
  }

  function image(div, format) {
    var f = dressed(div);
    Object.assign(f.layout, { showlegend: true, paper_bgcolor: colour("--card"), legend: { orientation: "h", y: 1.02, yanchor: "bottom" } });
    f.layout.margin.t = 70;
    Plotly.downloadImage(f, { format: format, filename: div.id, width: Math.max(div.clientWidth, 900), height: div.clientHeight + 50, scale: 2 });
  }

  function cell(text) {
    text = String(text === null || text === undefined ? "" : text);
    if (/^[=+\-@\t\r]/.test(text) && isNaN(Number(text))) text = "'" + text; // no formula of a spreadsheet
    return /[",\n\r]/.test(text) ? '"' + text.replace(/"/g, '""') + '"' : text;
  }

  function short(v) { return typeof v === "number" ? Number(v.toPrecision(7)) : v; } // as exact as a page holds it

  function csv(div) {
    var figure = figures.get(div), f = given(div), rows = [["series", "panel", "x", "y"]];
    if (figure.scene) {
      rows = [["series", "x", "y", "z"]];
      f.lines.forEach(function (l) {
        l.points.forEach(function (p) { rows.push([l.name].concat(p)); });
      });
    } else {
      f.data.forEach(function (t) {
        var axis = f.layout["yaxis" + (t.yaxis || "y").slice(1)] || {};
        for (var i = 0; i < (t.y || []).length; i++)
          rows.push([t.name || "", (axis.title || {}).text || "", short(t.x[i]), short(t.y[i])]);
      });
      var power = (f.layout.meta || {}).spectrogram;
      if (power) {
        rows[0].push("dB");
        cells(power).forEach(function (v, i) {
          var row = Math.floor(i / power.columns), column = i % power.columns;
          if (v) rows.push(["power", "", power.start + (column + 0.5) / power.columns * (power.end - power.start),
            (row + 0.5) / power.rows * power.top, power.low + (v - 1) / 254 * (power.high - power.low)]);
        });
      }
    }
    return rows.map(function (r) { return r.map(cell).join(","); }).join("\r\n") + "\r\n";
  }

  function save(name, type, text) {
    var a = document.createElement("a");
    a.href = URL.createObjectURL(new Blob([text], { type: type }));
    a.download = name;
    a.click();
    setTimeout(function () { URL.revokeObjectURL(a.href); }, 1000);
  }

  // ---- tracks in space: a projection without perspective, turned by dragging or by arrow keys

  var SVG = "http://www.w3.org/2000/svg";

  function scene(div, figure) {
    var f = given(div), svg = document.createElementNS(SVG, "svg"), turn = f.turn || -0.6, tilt = f.tilt || 0.5;
    div.append(svg);

    function paint() {
      var centre = [0, 1, 2].map(function (k) { return (f.low[k] + f.high[k]) / 2; });
      var reach = Math.max(0.1, Math.hypot.apply(null, [0, 1, 2].map(function (k) { return f.high[k] - f.low[k]; })));
      var w = div.clientWidth, h = div.clientHeight, scale = 0.86 * Math.min(w, h * 1.25) / reach;
      var c = Math.cos(turn), s = Math.sin(turn), ct = Math.cos(tilt), st = Math.sin(tilt);
      svg.setAttribute("viewBox", "0 0 " + w + " " + h);
      function at(p) { // east, north, up
        var x = p[0] - centre[0], y = p[1] - centre[1], z = p[2] - centre[2];
        return [(w / 2 + scale * (c * x - s * y)).toFixed(1), (h / 2 - scale * (st * (s * x + c * y) + ct * z)).toFixed(1)];
      }
      function path(points, kind, colourName) {
        var d = "", pen = "M";
        points.forEach(function (p) {
          if (p[0] === null) { pen = "M"; return; }
          var q = at(p);
          d += pen + q[0] + " " + q[1]; pen = "L";
        });
        var e = document.createElementNS(SVG, "path");
        e.setAttribute("d", d); e.setAttribute("class", kind);
        if (colourName) e.style.stroke = prefersDark.matches && !printing ? darkOf[colourName] || colourName : colourName;
        svg.append(e);
      }
      function word(p, text) {
        var q = at(p), e = document.createElementNS(SVG, "text");
        e.setAttribute("x", Math.min(Math.max(q[0], 20), w - 20)); e.setAttribute("y", q[1]); e.textContent = text;
        svg.append(e);
      }
      svg.replaceChildren();
      var lo = f.low, hi = f.high, ground = [];
      for (var i = 0; i <= 4; i++) {
        var a = lo[0] + (hi[0] - lo[0]) * i / 4, b = lo[1] + (hi[1] - lo[1]) * i / 4;
        ground.push([a, lo[1], lo[2]], [a, hi[1], lo[2]], [null], [lo[0], b, lo[2]], [hi[0], b, lo[2]], [null]);
      }
      path(ground, "ground");
      path([[lo[0], lo[1], lo[2]], [lo[0], lo[1], hi[2]]], "post");
      f.lines.forEach(function (l) {
        path(l.points.map(function (p) { return p[0] === null ? p : [p[0], p[1], lo[2]]; }), "shadow", l.colour);
      });
      f.lines.forEach(function (l) { path(l.points, "track " + (l.dash || ""), l.colour); });
      (f.bodies || []).forEach(function (b) { path(b, "body"); });
      word([(lo[0] + hi[0]) / 2, hi[1] + 0.06 * reach, lo[2]], "north " + f.span[1]);
      word([hi[0] + 0.06 * reach, (lo[1] + hi[1]) / 2, lo[2]], "east " + f.span[0]);
      word([lo[0], lo[1], hi[2] + 0.05 * reach], "up " + f.span[2]);
    }

    paint();
    figure.paint = paint;
    div.addEventListener("pointerdown", function (e) { div.setPointerCapture(e.pointerId); div.dataset.turning = "1"; });
    div.addEventListener("pointerup", function () { delete div.dataset.turning; });
    div.addEventListener("pointermove", function (e) {
      if (!div.dataset.turning) return;
      turn += e.movementX / 150; tilt = Math.min(1.57, Math.max(0, tilt + e.movementY / 150));
      paint();
    });
    div.addEventListener("keydown", function (e) {
      var by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
      if (!by) return;
      e.preventDefault();
      turn += by[0]; tilt = Math.min(1.57, Math.max(0, tilt + by[1]));
      paint();
    });
    new ResizeObserver(paint).observe(div);
    keys(div, { data: f.lines.map(function (l) {
      return { name: l.name, line: { width: 2, dash: l.dash, color: prefersDark.matches ? darkOf[l.colour] || l.colour : l.colour } };
    }) });
    div.parentNode.querySelectorAll(".key").forEach(function (b) { b.disabled = true; });
  }

  // ---- the page

  document.querySelectorAll("script[data-for]").forEach(function (script) {
    var div = document.getElementById(script.dataset.for);
    div.tabIndex = 0;
    var strip = strips[script.dataset.time];
    if (strip) div.style.height = parseFloat(div.style.height) + strip.height + "px";
    figures.set(div, { script: script, drawn: false, hidden: new Set(), scene: div.classList.contains("scene") });
    if (figures.get(div).scene) return;
    div.addEventListener("keydown", function (e) {
      var axis = div._fullLayout && div._fullLayout.xaxis;
      if (!axis || axis.type !== "linear") return;
      var a = axis.range[0], b = axis.range[1], w = b - a;
      var to = { ArrowLeft: [a - w / 5, b - w / 5], ArrowRight: [a + w / 5, b + w / 5], "+": [a + w / 5, b - w / 5],
                 "-": [a - w / 3, b + w / 3], Home: null, Escape: null }[e.key];
      if (to === undefined) return;
      e.preventDefault();
      if (to && !(given(div).layout.meta || {}).time) Plotly.relayout(div, { "xaxis.range": to }); else look(div, to);
    });
  });

  function redraw() {
    figures.forEach(function (figure, div) {
      if (!figure.drawn) return;
      if (figure.scene) { figure.paint(); } else draw(div);
      var swatches = div.parentNode.querySelectorAll(".key i"), dark = prefersDark.matches && !printing;
      var light = Object.fromEntries(Object.entries(darkOf).map(function (e) { return [e[1], e[0]]; }));
      swatches.forEach(function (i) {
        var c = i.dataset.colour;
        i.style.color = dark ? darkOf[c] || c : light[c] || c;
      });
    });
  }

  function all() {
    document.querySelectorAll("details").forEach(function (d) { d.open = true; });
    figures.forEach(function (_, div) { draw(div); });
  }

  function copies() {
    document.querySelectorAll("button.copy").forEach(function (b) {
      b.addEventListener("click", function () {
        navigator.clipboard.writeText(b.dataset.text).then(function () { b.textContent = "copied"; });
      });
    });
  }

  function begin() {
    window.drawAll = all;
    copies();
    window.liveFigures = { // for a page whose numbers go on
      ids: function () { return Array.from(figures.keys(), function (div) { return div.id; }); },
      isHidden: function (id, trace) { return figures.get(document.getElementById(id)).hidden.has(keyOf(trace)); },
      given: function (id) { return given(document.getElementById(id)); },
      show: function (id) { // draws it anew, where it was drawn
        var div = document.getElementById(id), figure = figures.get(div);
        if (figure.drawn) { if (figure.scene) figure.paint(); else draw(div); }
      }
    };
    window.addEventListener("beforeprint", function () { printing = true; all(); redraw(); });
    window.addEventListener("afterprint", function () { printing = false; redraw(); });
    prefersDark.addEventListener("change", redraw);
    var seen = new IntersectionObserver(function (entries) {
      entries.forEach(function (e) { if (e.isIntersecting) { seen.unobserve(e.target); draw(e.target); } });
    }, { rootMargin: "900px 0px" });
    figures.forEach(function (_, div) { seen.observe(div); });
    window.addEventListener("hashchange", goToMoment);
    goToMoment();
    document.documentElement.dataset.ready = "yes";
  }

  function unpacked(id) {
    var bytes = bytesOf(document.getElementById(id).textContent);
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }

  if (!("DecompressionStream" in window)) {
    document.body.classList.add("old");
    return;
  }
  Promise.all([unpacked("plotly"), unpacked("figures")]).then(function (sources) {
    var script = document.createElement("script");
    script.textContent = sources[0];
    stored = JSON.parse(sources[1]);
    document.head.append(script);
    begin();
  });
})();
