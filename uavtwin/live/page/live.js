// Fills the page of a live flight from its WebSocket. Text of the aircraft is set as text, never as HTML.
(function () {
  "use strict";
  var KEPT_S = 300, FIRST_WAIT_MS = 500, LONGEST_WAIT_MS = 8000, DEAD_MS = 6000, SILENT_MS = 2000, AGES = 2000;
  var MOST_SAID = 200;
  var id = function (name) { return document.getElementById(name); };
  var darkOf = JSON.parse(id("dark-colours").textContent);
  var cells = Array.from(document.querySelectorAll("[data-now]"));
  var columns = {}, rests = "", alarms = new Map(), bands = {}, lost = 0;
  var newest = null, shownAt = null, until = null, paused = false, connected = false, outdated = true;
  var socket = null, wait = FIRST_WAIT_MS, retryAt = 0, heardAt = 0, stale = new Set(), drawnUntil = 0;
  var offset = 0, leastTrip = Infinity, ages = [], held = [];

  // ---- what has come

  function forget() {
    columns = {}; bands = {}; alarms.clear(); newest = shownAt = until = null;
    id("said").replaceChildren(element("p", "Nothing yet.", "dim")); id("alarms").replaceChildren(); id("until").textContent = "–";
    cells.forEach(function (c) { c.textContent = "–"; });
    touch();
  }

  function begin() { // of what a new connection brings; a paused page keeps what it shows until it goes on
    if (outdated) { outdated = false; forget(); showAlarms(); }
  }

  function column(name) { return columns[name] || (columns[name] = []); }

  function touch() { if (window.liveFigures) window.liveFigures.ids().forEach(function (f) { stale.add(f); }); }

  function trim(times, others) { // what is older than is shown; in large pieces, for each costs
    var last = times[times.length - 1], k = 0;
    while (k < times.length && times[k] < last - KEPT_S) k++;
    if (k < 500) return;
    times.splice(0, k);
    others.forEach(function (o) { o.splice(0, k); });
  }

  var VALUES = cells.map(function (c) { return c.dataset.now; });

  function takeNow(m) {
    var t = column("now.t");
    if (t.length && m.t < t[t.length - 1] - 1) { // the clock restarted
      Object.keys(columns).forEach(function (k) { delete columns[k]; });
      bands = {}; t = column("now.t");
    }
    newest = m;
    if (t.length && m.t - t[t.length - 1] < 0.09) return; // curves need no more
    Object.keys(m).forEach(function (k) {
      if (k === "kind" || k === "at" || k === "t") return;
      var c = column("now." + k);
      while (c.length < t.length) c.push(null);
      c.push(m[k]);
    });
    t.push(m.t);
    var rest = Object.keys(columns).filter(function (k) { return k.slice(0, 4) === "now." && k !== "now.t"; });
    rest.forEach(function (k) { while (columns[k].length < t.length) columns[k].push(null); });
    trim(t, rest.map(function (k) { return columns[k]; }));
  }

  function takeResiduals(m) {
    until = m.until;
    m.channels.forEach(function (c) {
      var key = (c.horizon_s > 0 ? "short." : "forced.") + c.name;
      var t = column(key + ".t"), r = column(key + ".residual");
      if (t.length && c.t.length && c.t[0] < t[t.length - 1]) { t.length = r.length = 0; delete bands[key]; }
      c.t.forEach(function (v, i) {
        if (t.length && v - t[t.length - 1] > 1) { t.push((v + t[t.length - 1]) / 2); r.push(null); } // on the ground
        t.push(v); r.push(c.residual[i]);
      });
      if (c.band) bands[key] = c.band;
      trim(t, [r]);
    });
  }

  var takes = {
    about: function (m) {
      id("claim").dataset.vehicle = m.vehicle;
      document.title = "Live: " + m.vehicle;
      document.querySelectorAll("[data-about]").forEach(function (e) { e.textContent = String(m[e.dataset.about]); });
    },
    now: takeNow,
    residuals: takeResiduals,
    alarm: function (m) { alarms.set(m.id, m); showAlarms(); },
    said: function (m) { showSaid(m); },
    health: function (m) { showHealth(m); },
    dropped: function (m) { lost = m.count; },
    pong: function (m) {
      var now = Date.now(), trip = now - m.ping;
      if (trip < leastTrip) { leastTrip = trip; offset = m.at - (m.ping + now) / 2; }
    }
  };

  function take(m) { if (takes[m.kind]) takes[m.kind](m); }

  // ---- words and numbers

  function element(kind, text, className) {
    var e = document.createElement(kind);
    e.textContent = text;
    if (className) e.className = className;
    return e;
  }

  function isOver(a) { return a.closed_s !== null && a.closed_s !== undefined; }

  function showAlarms() {
    var all = Array.from(alarms.values()).sort(function (a, b) { return isOver(a) - isOver(b) || b.raised_s - a.raised_s; });
    var open = all.filter(function (a) { return !isOver(a); });
    id("alarms").replaceChildren.apply(id("alarms"), all.length ? all.slice(0, 30).map(function (a) {
      var words = a.text + "; raised at " + a.raised_s.toFixed(1) + " s, " + a.delay_s.toFixed(1) + " s after it could be known.";
      var e = element("p", words, isOver(a) ? "alarm over" : "alarm");
      e.dataset.cause = a.cause;
      return e;
    }) : [element("p", rests || "No alarm.", "dim")]);
    id("claim").dataset.open = String(open.length);
    touch();
  }

  function showSaid(m) {
    var place = id("said"), none = place.querySelector(".dim"), at = new Date(m.at).toLocaleTimeString();
    if (none) none.remove();
    place.prepend(element("p", at + "  " + m.severity + ": " + m.text));
    while (place.childElementCount > MOST_SAID) place.lastElementChild.remove();
  }

  function number(value, digits) { return typeof value === "number" ? value.toFixed(digits) : "unknown"; }

  function showHealth(m) {
    var link = m.link, clock = m.clock, rows = [
      ["aircraft", link.system === null ? "none heard" : "system " + link.system + " at " + link.sender],
      ["messages", link.messages + ", " + link.lost + " lost (" + number(100 * link.lost / Math.max(1, link.messages + link.lost), 2) + " %), " +
        link.duplicates + " twice, " + link.reordered + " overtaken, " + link.jumps + " jumps of the sequence"],
      ["left out", link.late + " samples too late, " + link.strays + " of a stray time, " + link.wrong + " frames damaged, " + link.garbage + " bytes that are no message"],
      ["others", Object.entries(link.others).map(function (o) { return o[1] + " of " + o[0]; }).join("; ") || "none"],
      ["clock", clock ? "ours less the aircraft's " + number(clock.offset_s, 4) + " s, drift " + number(clock.drift_ppm, 1) + " ppm, by " + clock.source : "unknown"],
      ["signals", Object.entries(m.sources).map(function (s) { return s[0] + " of " + s[1]; }).join(", ") || "none"],
      ["flights", m.sections + " since the start; the twin " + (m.waits_for ? "waits for " + m.waits_for : "flies")],
      ["this program", number(100 * m.busy, 0) + " % of a core; " + m.viewers + " viewers; this viewer lost " + lost + " messages"]
    ];
    if (m.model) rows.splice(7, 0, ["compensator",
      (m.model.anomaly === null ? "" : "anomaly " + number(m.model.anomaly, 2) + " (above 1 is unusual), " + number(100 * m.model.unusual, 1) + " % of the flight above; ") +
      number(100 * m.model.inside, 0) + " % where training has been; sees " + (m.model.horizon_s === null ? "no residuals" : "residuals of " + number(m.model.horizon_s, 2) + " s ago")]);
    id("health").replaceChildren.apply(id("health"), rows.flatMap(function (r) { return [element("dt", r[0]), element("dd", r[1])]; }));
    id("missing").replaceChildren.apply(id("missing"), Object.values(m.missing).concat(m.misfit || []).map(function (text) { return element("p", text, "warn"); }));
    id("claim").dataset.heard = link.system === null ? "" : "yes";
    if (rests !== m.rests) { rests = m.rests; showAlarms(); }
  }

  function showClaim() {
    var claim = id("claim"), open = Number(claim.dataset.open || 0), vehicle = claim.dataset.vehicle || "twin";
    var text = !claim.dataset.heard && !newest ? vehicle + ": nothing heard yet" : open ? vehicle + ": " + open + (open > 1 ? " alarms" : " alarm") : vehicle + ": no alarm";
    if (claim.textContent !== text) claim.textContent = text;
  }

  function showNow() { // numbers at once, whatever the figures do
    if (!newest || paused) return;
    for (var i = 0; i < cells.length; i++) {
      var v = newest[VALUES[i]];
      cells[i].textContent = typeof v === "number" ? v.toFixed(cells[i].dataset.digits) : "–";
    }
    id("time").textContent = newest.t.toFixed(1);
    id("until").textContent = until === null ? "–" : until.toFixed(1);
    if (shownAt !== newest.at) noteAge();
    shownAt = newest.at;
  }

  function noteAge() { // of what was shown until now, and of what is shown from now on
    if (shownAt !== null) ages.push([Date.now() + offset - newest.at, Date.now() + offset - shownAt]);
    if (ages.length > AGES) ages.splice(0, AGES / 2);
  }

  function showState() {
    var now = Date.now(), age = shownAt === null ? null : now + offset - shownAt, state = "live", text = "live";
    if (!connected) {
      state = "lost";
      text = "disconnected; next try in " + Math.max(0, (retryAt - now) / 1000).toFixed(0) + " s";
    } else if (paused) { state = "paused"; text = "paused"; }
    else if (age === null) { state = "silent"; text = "connected, nothing comes from the aircraft"; }
    else if (age > SILENT_MS) { state = "silent"; text = "nothing new from the aircraft for " + (age / 1000).toFixed(0) + " s"; }
    if (id("state").textContent !== text) id("state").textContent = text;
    id("state").dataset.state = state;
    document.body.classList.toggle("lost", !connected);
    id("age").textContent = age === null ? "–" : age < 2000 ? Math.max(0, age).toFixed(0) + " ms" : (age / 1000).toFixed(0) + " s";
    showClaim();
    if (connected && now - heardAt > DEAD_MS) socket.close();
  }

  // ---- figures

  function within(times, values, from) {
    var low = 0, high = times.length;
    while (low < high) { var k = (low + high) >> 1; if (times[k] < from) low = k + 1; else high = k; }
    return [times.slice(low), values.slice(low)];
  }

  function timed(figure, end, span) {
    figure.data.forEach(function (trace) {
      var got = within(columns[trace.meta.x] || [], columns[trace.meta.y] || [], end - span);
      trace.x = got[0]; trace.y = got[1];
    });
    var layout = figure.layout;
    Object.keys(layout).forEach(function (k) { if (/^xaxis\d*$/.test(k)) layout[k].range = [Math.max(0, end - span), Math.max(end, 1)]; });
    layout.shapes = layout.shapes.filter(function (s) { return s.name !== "alarm"; });
    layout.shapes.forEach(function (s) {
      var band = bands[s.name];
      s.visible = Boolean(band);
      if (band) { s.y0 = band[0]; s.y1 = band[1]; }
    });
    alarms.forEach(function (a) {
      if (isOver(a) || a.onset_s === null || a.onset_s < end - span) return;
      layout.shapes.push({ name: "alarm", type: "line", xref: "x", yref: "paper", x0: a.onset_s, x1: a.onset_s, y0: 0, y1: 1,
        line: { width: 1, dash: "dot", color: "#c23b66" }, layer: "below" });
    });
  }

  function flown(figure, end, span) {
    var t = columns["now.t"] || [];
    figure.data.forEach(function (trace) {
      var get = function (name) {
        var up = /up$/.test(name), from = columns["now." + name.slice(6).replace(/up$/, "pos_z")] || [];
        var got = within(t, from, end - span)[1];
        return up ? got.map(function (v) { return v === null ? null : -v; }) : got;
      };
      trace.x = get(trace.meta.x); trace.y = get(trace.meta.y);
    });
  }

  function turned(q, v) { // body to NED
    var w = q[0], x = q[1], y = q[2], z = q[3];
    return [
      (1 - 2 * (y * y + z * z)) * v[0] + 2 * (x * y - w * z) * v[1] + 2 * (x * z + w * y) * v[2],
      2 * (x * y + w * z) * v[0] + (1 - 2 * (x * x + z * z)) * v[1] + 2 * (y * z - w * x) * v[2],
      2 * (x * z - w * y) * v[0] + 2 * (y * z + w * x) * v[1] + (1 - 2 * (x * x + y * y)) * v[2]
    ];
  }

  function inSpace(figure, end, span) {
    var t = columns["now.t"] || [], low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    figure.lines.forEach(function (line) {
      var p = (line.name === "twin" ? "now.twin." : "now.");
      var n = ["pos_x", "pos_y", "pos_z"].map(function (c) { return within(t, columns[p + c] || [], end - span)[1]; });
      line.points = n[0].map(function (north, k) {
        if (typeof north !== "number" || typeof n[1][k] !== "number" || typeof n[2][k] !== "number") return [null];
        var point = [n[1][k], north, -n[2][k]];
        point.forEach(function (v, a) { low[a] = Math.min(low[a], v); high[a] = Math.max(high[a], v); });
        return point;
      });
    });
    if (!isFinite(low[0])) return;
    [0, 1, 2].forEach(function (a) {
      var half = Math.max(high[a] - low[a], 0.5) / 2, middle = (low[a] + high[a]) / 2;
      figure.low[a] = middle - half; figure.high[a] = middle + half;
      figure.span[a] = (2 * half).toPrecision(3) + " m";
    });
    var size = Math.max.apply(null, [0, 1, 2].map(function (a) { return figure.high[a] - figure.low[a]; })) / 10;
    var strokes = [[[1.6, 0, 0], [-1, 0, 0]], [[0, 1, 0], [0, -1, 0]], [[0, 0, 0], [0, 0, -0.8]]];
    figure.bodies = ["", "twin."].filter(function (p) { return newest && typeof newest[p + "q_w"] === "number" && typeof newest[p + "pos_x"] === "number"; }).map(function (p) {
      var q = ["q_w", "q_x", "q_y", "q_z"].map(function (c) { return newest[p + c]; }), points = [];
      strokes.forEach(function (s) {
        s.forEach(function (v) {
          var d = turned(q, v);
          points.push([newest[p + "pos_y"] + size * d[1], newest[p + "pos_x"] + size * d[0], -newest[p + "pos_z"] - size * d[2]]);
        });
        points.push([null]);
      });
      return points;
    });
  }

  function isSeen(name) {
    var box = id(name).getBoundingClientRect();
    return box.bottom > -100 && box.top < window.innerHeight + 100;
  }

  // While it goes on a figure is painted onto a canvas over it, which takes a hundredth of the time that the
  // plot takes, during which no number would change; when it pauses the plot is drawn, to be zoomed and pointed at.

  function colour(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }

  function round(low, high, most) { // where an axis is marked
    var raw = (high - low) / most, power = Math.pow(10, Math.floor(Math.log10(raw))), found = [];
    var step = power * [1, 2, 5, 10].find(function (m) { return m * power >= raw; });
    for (var v = Math.ceil(low / step) * step; v <= high + step / 1e6; v += step) found.push(Math.abs(v) < step / 1e6 ? 0 : v);
    return { at: found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }

  function extent(traces, key) {
    var low = Infinity, high = -Infinity;
    traces.forEach(function (t) { t[key].forEach(function (v) { if (v !== null && v < low) low = v; if (v !== null && v > high) high = v; }); });
    if (!isFinite(low)) return [-1, 1];
    var pad = 0.06 * (high - low) || 0.05 * Math.abs(high) || 0.5;
    return [low - pad, high + pad];
  }

  function panel(pen, box, traces, bandsHere, x, y, labels) {
    var px = function (v) { return box[0] + (v - x[0]) / (x[1] - x[0]) * box[2]; };
    var py = function (v) { return box[1] + box[3] - (v - y[0]) / (y[1] - y[0]) * box[3]; };
    pen.lineWidth = 1; pen.font = "11px system-ui, sans-serif"; pen.fillStyle = labels.dim; pen.strokeStyle = labels.grid;
    var marks = round(y[0], y[1], 4), along = round(x[0], x[1], Math.max(2, box[2] / 90));
    pen.textAlign = "right"; pen.textBaseline = "middle";
    marks.at.forEach(function (v) { line(pen, box[0], py(v), box[0] + box[2], py(v)); pen.fillText(v.toFixed(marks.digits), box[0] - 5, py(v)); });
    pen.textAlign = "center"; pen.textBaseline = "top";
    along.at.forEach(function (v) { line(pen, px(v), box[1], px(v), box[1] + box[3]); if (labels.x) pen.fillText(v.toFixed(along.digits), px(v), box[1] + box[3] + 5); });
    pen.fillStyle = labels.ink;
    if (labels.x) pen.fillText(labels.x, box[0] + box[2] / 2, box[1] + box[3] + 22);
    pen.save(); pen.translate(box[0] - 52, box[1] + box[3] / 2); pen.rotate(-Math.PI / 2); pen.fillText(labels.y, 0, 0); pen.restore();
    pen.save(); pen.beginPath(); pen.rect(box[0], box[1], box[2], box[3]); pen.clip();
    bandsHere.forEach(function (s) {
      if (s.type === "rect") { pen.globalAlpha = 0.16; pen.fillStyle = s.fillcolor; pen.fillRect(box[0], py(s.y1), box[2], py(s.y0) - py(s.y1)); pen.globalAlpha = 1; }
      else { pen.strokeStyle = labels.of(s.line.color); pen.setLineDash([2, 3]); line(pen, px(s.x0), box[1], px(s.x0), box[1] + box[3]); pen.setLineDash([]); }
    });
    traces.forEach(function (t) {
      pen.strokeStyle = labels.of(t.line.color); pen.lineWidth = t.line.width; pen.beginPath();
      for (var i = 0, down = false; i < t.x.length; i++) {
        if (t.x[i] === null || t.y[i] === null || t.y[i] === undefined) { down = false; continue; }
        if (down) pen.lineTo(px(t.x[i]), py(t.y[i])); else pen.moveTo(px(t.x[i]), py(t.y[i]));
        down = true;
      }
      pen.stroke();
    });
    pen.restore();
    pen.strokeStyle = labels.line; pen.lineWidth = 1; line(pen, box[0], box[1], box[0], box[1] + box[3]); line(pen, box[0], box[1] + box[3], box[0] + box[2], box[1] + box[3]);
  }

  function line(pen, x0, y0, x1, y1) { pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x1, y1); pen.stroke(); }

  function paint(name, figure) {
    var div = id(name), canvas = div.parentNode.querySelector("canvas"), ratio = window.devicePixelRatio || 1;
    if (!canvas) { canvas = document.createElement("canvas"); div.parentNode.append(canvas); }
    var w = div.clientWidth, h = div.clientHeight, left = 62, layout = figure.layout, margin = layout.margin;
    canvas.width = w * ratio; canvas.height = h * ratio;
    canvas.style.cssText = "left:" + div.offsetLeft + "px;top:" + div.offsetTop + "px;width:" + w + "px;height:" + h + "px";
    var pen = canvas.getContext("2d"), dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
    pen.scale(ratio, ratio);
    var labels = { ink: colour("--ink"), dim: colour("--dim"), grid: colour("--grid"), line: colour("--line"),
      of: function (c) { return dark ? darkOf[c] || c : c; } };
    var shown = figure.data.filter(function (t) { return !window.liveFigures.isHidden(name, t); }), full = h - margin.t - margin.b;
    Object.keys(layout).filter(function (k) { return /^yaxis\d*$/.test(k); }).forEach(function (k) {
      var number = k.slice(5), across = layout["xaxis" + number], along = layout[k];
      var traces = shown.filter(function (t) { return t.yaxis === "y" + number; });
      var box = [left, margin.t + (1 - along.domain[1]) * full, w - left - 14, (along.domain[1] - along.domain[0]) * full];
      var here = layout.shapes.filter(function (s) { return s.visible !== false && (s.yref === "paper" || s.yref === "y" + number); });
      var rects = here.filter(function (s) { return s.type === "rect"; }).map(function (s) { return { y: [s.y0, s.y1] }; });
      var x = across.range || extent(traces, "x"), y = extent(traces.concat(rects), "y");
      if (along.scaleanchor) { // one scale for both
        var scale = Math.max((x[1] - x[0]) / box[2], (y[1] - y[0]) / box[3], 0.5 / box[3]);
        var xm = (x[0] + x[1]) / 2, ym = (y[0] + y[1]) / 2;
        x = [xm - scale * box[2] / 2, xm + scale * box[2] / 2]; y = [ym - scale * box[3] / 2, ym + scale * box[3] / 2];
      }
      labels.x = (across.title || {}).text; labels.y = along.title.text;
      panel(pen, box, traces, here, x, y, labels);
    });
  }

  function unpaint(name) {
    var canvas = id(name).parentNode.querySelector("canvas");
    if (canvas) canvas.remove();
  }

  function drawNext() { // one figure at a time, in a quarter of the time at most
    var started = performance.now(), figures = window.liveFigures;
    if (!figures || started < drawnUntil || !newest) return;
    var name = Array.from(stale).find(isSeen);
    if (!name) return;
    stale.delete(name);
    var figure = figures.given(name), span = Number(id("span").value), times = columns["now.t"] || [];
    var end = times.length ? times[times.length - 1] : 0;
    if (figure.lines) inSpace(figure, end, span);
    else if (/^track/.test(name)) flown(figure, end, span);
    else timed(figure, end, span);
    if (figure.lines) figures.show(name);
    else if (paused) { unpaint(name); figures.show(name); }
    else paint(name, figure);
    drawnUntil = performance.now() + 3 * (performance.now() - started);
  }

  // ---- the connection

  function connect() {
    socket = new WebSocket(location.href.replace(/^http/, "ws").replace(/[?#].*$/, "").replace(/\/?$/, "/stream"));
    var mine = socket;
    socket.onopen = function () {
      connected = true; wait = FIRST_WAIT_MS; heardAt = Date.now(); leastTrip = Infinity;
      held = []; outdated = true; ping();
      if (!paused) begin();
    };
    socket.onmessage = function (event) {
      heardAt = Date.now();
      var messages = JSON.parse(event.data);
      if (paused) { held = held.concat(messages.filter(function (m) { return m.kind !== "pong"; })).slice(-5000); messages = messages.filter(function (m) { return m.kind === "pong"; }); }
      messages.forEach(take);
      showNow();
    };
    socket.onclose = function () {
      if (mine !== socket) return;
      connected = false;
      retryAt = Date.now() + wait * (0.75 + Math.random() / 2);
      wait = Math.min(2 * wait, LONGEST_WAIT_MS);
      showState();
      setTimeout(connect, retryAt - Date.now());
    };
  }

  function ping() { if (connected && socket.readyState === 1) socket.send(JSON.stringify({ ping: Date.now() })); }

  id("pause").addEventListener("click", function () {
    paused = !paused;
    id("pause").textContent = paused ? "Go on" : "Pause";
    id("pause").setAttribute("aria-pressed", String(paused));
    if (!paused) { begin(); held.forEach(take); held = []; shownAt = null; showNow(); }
    touch();
    showState();
  });
  id("span").addEventListener("change", touch);
  window.live = { ages: function () { return ages; }, clearAges: function () { ages = []; } }; // for measurements
  setInterval(showState, 100);
  setInterval(drawNext, 50);
  setInterval(function () { if (!paused) touch(); }, 200);
  setInterval(ping, 2000);
  connect();
})();
