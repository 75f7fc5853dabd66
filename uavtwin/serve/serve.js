// Uploads what is dropped, and shows what the server says of flights. Without it the links and forms of the page work.
(function () {
  "use strict";
  var TRIES = 8, AT_ONCE = 2;
  var drop = document.getElementById("drop"), list = document.getElementById("uploads");
  var waiting = [], under = 0;

  // ---- uploads: one request per file, its body the bytes as they are

  function take(files) {
    Array.from(files).forEach(function (file) {
      var item = document.createElement("li"), name = document.createElement("span"), bar = document.createElement("progress");
      name.textContent = file.name;
      bar.max = 1; bar.value = 0;
      bar.setAttribute("aria-label", "upload of " + file.name);
      item.append(name, bar);
      list.append(item);
      waiting.push({ file: file, item: item, name: name, bar: bar, tries: 0 });
    });
    next();
  }

  function next() {
    while (under < AT_ONCE && waiting.length) { under += 1; send(waiting.shift()); }
  }

  function ended(upload, text, bad) {
    under -= 1;
    if (text) { upload.name.textContent = upload.file.name + ": " + text; upload.bar.remove(); }
    if (bad) upload.item.className = "bad";
    if (text && !bad) setTimeout(function () { upload.item.remove(); }, 4000);
    next();
  }

  function send(upload) {
    var request = new XMLHttpRequest();
    request.open("PUT", "/upload/" + encodeURIComponent(upload.file.name));
    request.upload.onprogress = function (e) { if (e.lengthComputable) upload.bar.value = e.loaded / e.total; };
    request.onload = function () {
      var answer = {};
      try { answer = JSON.parse(request.responseText); } catch (_) { answer = { error: request.responseText }; }
      if (request.status >= 200 && request.status < 300) ended(upload, answer.note || (answer.created ? "is there" : "was there before"), false);
      else ended(upload, answer.error || "refused (" + request.status + ")", true);
    };
    request.onerror = function () { // no server: again, later each time
      upload.tries += 1;
      if (upload.tries > TRIES) { ended(upload, "the server does not answer; drop it again", true); return; }
      upload.name.textContent = upload.file.name + ": waits for the server";
      setTimeout(function () { upload.name.textContent = upload.file.name; send(upload); }, 500 * Math.pow(2, Math.min(upload.tries, 4)));
    };
    request.send(upload.file);
  }

  if (drop) {
    var chosen = document.getElementById("files"), depth = 0;
    chosen.addEventListener("change", function () { take(chosen.files); chosen.value = ""; });
    document.addEventListener("dragenter", function (e) { e.preventDefault(); depth += 1; document.body.classList.add("over"); });
    document.addEventListener("dragleave", function () { depth -= 1; if (depth <= 0) document.body.classList.remove("over"); });
    document.addEventListener("dragover", function (e) { e.preventDefault(); });
    document.addEventListener("drop", function (e) {
      e.preventDefault();
      depth = 0; document.body.classList.remove("over");
      take(e.dataTransfer.files);
    });
  }

  // ---- what is new of flights: parts of the page as the server draws them

  var rows = document.getElementById("rows"), one = document.querySelector("[data-events]");
  if (!rows && !one) return;

  function replace(there, html) {
    var focused = document.activeElement, id = focused && there.contains(focused) ? focused.id || focused.value : "";
    var ticked = there.querySelector("input:checked"), scrolled = there.querySelector(".moments");
    var top = scrolled ? scrolled.scrollTop : 0;
    var made = document.createElement("template");
    made.innerHTML = html.trim();
    var part = made.content.firstElementChild;
    there.replaceWith(part);
    if (ticked) part.querySelector("input").checked = true;
    if (top) part.querySelector(".moments").scrollTop = top;
    if (!id) return;
    var again = Array.from(part.querySelectorAll("a, button, input")).find(function (e) { return e.id === id || e.value === id; });
    if (again) again.focus();
  }

  function hear(parts) { // by identifier of the element; null: it is gone
    Object.keys(parts).forEach(function (id) {
      var there = document.getElementById(id), html = parts[id];
      if (html === null) { if (there) there.remove(); }
      else if (there) { if (there.outerHTML !== html.trim()) replace(there, html); }
      else if (rows && !rows.closest("table").dataset.search) {
        var made = document.createElement("template");
        made.innerHTML = html.trim();
        rows.prepend(made.content.firstElementChild);
      }
    });
    var none = document.getElementById("none");
    if (none && rows) none.hidden = rows.children.length > 0;
  }

  var lost = document.createElement("div");
  lost.className = "lost-server";
  lost.setAttribute("role", "status");
  lost.textContent = "The server does not answer. What it had begun goes on when it is started again; this page then too.";
  function connect() {
    var source = new EventSource("/events" + (one ? "?flight=" + one.dataset.events : ""));
    source.onmessage = function (e) { hear(JSON.parse(e.data)); };
    source.onopen = function () { lost.remove(); document.documentElement.dataset.connected = "yes"; };
    source.onerror = function () {
      delete document.documentElement.dataset.connected;
      document.body.prepend(lost);
      if (source.readyState === EventSource.CLOSED) setTimeout(connect, 2000); // a refusal ends it for good
    };
  }
  connect();
  window.addEventListener("pageshow", function (e) { if (e.persisted) location.reload(); });
})();
