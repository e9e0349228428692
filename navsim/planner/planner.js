// The page of the planner: what is seen is what the server told; what is asked goes out as orders.
window.planner = (function () {
  "use strict";
  const $ = (id) => document.getElementById(id);
  const state = { pseudolites: [], jammers: [], beacons: [], shares: [], figures: [], warnings: [], problems: [] };
  // of each answer to a drag: ms from the mouse's being there to the answer and to its being drawn, of them at work on the
  // map, when, and cells of a side
  const trips = [];
  let orders = null, news = null, places = null, figure = null;
  let number = 0, flying = [], next = null, held = null, begun = false;

  function send(order) { orders.data = { order: [JSON.stringify(order)] }; }

  // while something moves two orders are under way, one at the server, one being drawn; the latest place waits, and what
  // lies between is dropped
  function hurry(order) {
    order.n = ++number;
    order.at = performance.now();
    if (flying.length < 2) { flying.push(order); send(order); } else { next = order; }
  }
  function answered(of, map) {
    const order = flying.find((each) => each.n === of);
    if (order === undefined) { return; }
    const answer = performance.now();
    follow();
    requestAnimationFrame(() => {
      const now = performance.now();
      trips.push({ took: now - order.at, answer: answer - order.at, at: now, size: map ? map.size : 0, work: map ? 1000 * map.took : 0 });
      flying = flying.filter((each) => each.n > of);  // the server gave up those before
      if (next !== null && flying.length < 2) { const waiting = next; next = null; flying.push(waiting); send(waiting); }
    });
  }
  // what settles things comes after all that moved them
  function settle(order) { next = null; flying = []; document.body.dataset.resting = "false"; order.n = ++number; send(order); }

  function snapped(x) {
    const step = Number($("snap").value);
    return Math.round(Math.round(x / step) * step * 1000) / 1000;
  }
  function nearest(event) {
    const xs = Bokeh.index.find_one(figure).frame.x_scale, ys = Bokeh.index.find_one(figure).frame.y_scale;
    let best = null, least = 18;
    for (let i = 0; i < places.data.x.length; i++) {
      const d = Math.hypot(xs.compute(places.data.x[i]) - event.sx, ys.compute(places.data.y[i]) - event.sy);
      if (d < least) { least = d; best = i; }
    }
    return best;
  }
  // the mark under the mouse moves with each map, not beside it: the plot is drawn once for both
  function follow() {
    if (held === null || held.x === undefined) { return; }
    const data = Object.assign({}, places.data, { x: [...places.data.x], y: [...places.data.y] });
    data.x[held.index] = held.x; data.y[held.index] = held.y;
    places.data = data;
  }
  function pan(event) {
    if (figure === null || figure.toolbar.gestures.pan.active) { return; }
    if (event.event_name === "panstart") {
      held = nearest(event);
      if (held === null) { return; }
      const kind = places.data.kind[held];
      const jammed = state.pseudolites.length, ranged = jammed + state.jammers.length;
      held = { index: held, kind: kind, number: held - ({ jammer: jammed, beacon: ranged }[kind] || 0),
               dx: places.data.x[held] - event.x, dy: places.data.y[held] - event.y };
    }
    if (held === null) { return; }
    if (event.event_name !== "panstart") {
      const x = snapped(event.x + held.dx), y = snapped(event.y + held.dy);
      held.x = x; held.y = y;
      if (flying.length === 0 || event.event_name === "panend") { follow(); }
      const order = { do: event.event_name === "pan" ? "drag" : "place", kind: held.kind, number: held.number, x: x, y: y };
      const row = $("transmitters").tBodies[0].rows[held.index];
      if (row) { row.cells[1].firstChild.value = x; row.cells[2].firstChild.value = y; }
      if (event.event_name === "pan") { hurry(order); } else { settle(order); held = null; }
    }
  }

  function element(tag, text, more) {
    const out = document.createElement(tag);
    if (text !== undefined) { out.textContent = text; }
    return Object.assign(out, more || {});
  }
  function options(select, choices, chosen) {
    select.replaceChildren(...choices.map(([value, said, off]) => element("option", said, { value: value, disabled: Boolean(off), title: off || "" })));
    select.value = chosen;
  }
  function pad(n) { return String(n).padStart(2, "0"); }
  function clock(seconds) {
    const whole = Math.floor(seconds + 1e-6), part = seconds - whole;
    return `${pad(Math.floor(whole / 3600))}:${pad(Math.floor(whole / 60) % 60)}:${pad(whole % 60)}${part > 1e-6 ? part.toFixed(3).slice(1) : ""}`;
  }

  // the number in a field, NaN where there is none: Number("") is 0
  function entered(input) { return input.value.trim() === "" ? NaN : Number(input.value); }
  // the fields of a transmitter; what is no number gives way to what stood there
  function coordinates(row, name, values, change) {
    const inputs = Object.entries(values).map(([axis, value]) => {
      const input = element("input", undefined, { type: "number", step: "any", value: value });
      input.setAttribute("aria-label", `${name} ${axis}, m`);
      row.insertCell().append(input);
      return input;
    });
    for (const input of inputs) {
      let last = input.value;
      input.addEventListener("focus", () => { if (Number.isFinite(entered(input))) { last = input.value; } });
      input.addEventListener("change", () => {
        if (!Number.isFinite(entered(input))) { input.value = last; return; }
        last = input.value;
        change(...inputs.map(entered));
      });
      input.addEventListener("blur", () => { if (!Number.isFinite(entered(input))) { input.value = last; } });
    }
  }
  function transmitters() {
    const body = $("transmitters").tBodies[0];
    body.replaceChildren();
    state.pseudolites.forEach((each, i) => {
      const row = body.insertRow();
      row.insertCell().append(element("i"), each.name);
      coordinates(row, each.name, { along: each.x, right: each.y, up: each.up },
                  (x, y, up) => settle({ do: "place", kind: "pseudolite", number: i, x: x, y: y, up: up }));
      const away = element("button", "Remove");
      away.setAttribute("aria-label", `Remove ${each.name}`);
      away.addEventListener("click", () => settle({ do: "remove", number: i }));
      row.insertCell().append(away);
    });
    state.jammers.forEach((each, i) => {
      const row = body.insertRow();
      row.className = "jammer";
      row.insertCell().append(element("i"), each.name);
      coordinates(row, each.name, { along: each.x, right: each.y },
                  (x, y) => settle({ do: "place", kind: "jammer", number: i, x: x, y: y }));
    });
    state.beacons.forEach((each, i) => {
      const row = body.insertRow();
      row.className = "beacon";
      row.insertCell().append(element("i"), each.name);
      coordinates(row, each.name, { along: each.x, right: each.y, up: each.up },
                  (x, y, up) => settle({ do: "place", kind: "beacon", number: i, x: x, y: y, up: up }));
    });
    options($("subject"), [...state.pseudolites.map((p, i) => [i, p.name]), [-1, `${state.more} (additional)`]], state.subject);
  }
  function figures() {
    $("figures").replaceChildren(...state.figures.map((each) => {
      const card = element("div"), value = element("dd", each.value);
      value.dataset.path = each.path;
      if (each.unit) { value.append(element("small", ` ${each.unit}`)); }
      card.append(element("dt", each.said), value);
      return card;
    }));
    $("exact").textContent = state.exact ? "all fix epochs, as in navsim run" : "while something moves: every eighth epoch";
    $("exact").dataset.exact = state.exact;
  }
  function shares() {
    const most = Math.max(...state.shares.map((s) => (typeof s.more === "number" ? s.more : 0)), 0.01);
    const body = $("shares").tBodies[0];
    body.replaceChildren();
    for (const each of state.shares) {
      const row = body.insertRow();
      row.className = [each.ground ? "ground" : "", each.used ? "" : "unused"].join(" ");
      row.insertCell().textContent = each.name;
      const without = each.without === null ? "not used" : each.without === "none" ? "no fix" : each.without.toFixed(3);
      row.insertCell().textContent = without;
      const cell = row.insertCell();
      if (each.used) {
        const share = typeof each.more === "number" ? each.more / most : 1;
        const b = element("b", undefined, { title: typeof each.more === "number" ? `PDOP ${(100 * each.more).toFixed(1)} % larger` : "no fix without it" });
        b.style.width = `${Math.max(0, 100 * share)}%`;
        cell.append(b);
      }
    }
  }
  function about(map) {
    const with_ = map.subject < 0 ? `${state.more}, an additional pseudolite,` : (state.pseudolites[map.subject] || {}).name;
    const unit = map.unit ? ` ${map.unit}` : "";
    $("about").textContent = `${map.said}, with ${with_} at this point and all others at their positions; ${map.low.toPrecision(4)} to ${map.high.toPrecision(4)}${unit}, ${map.size} × ${map.size} positions in ${(1000 * map.took).toFixed(0)} ms. The map is empty where there is no solution. Drag a transmitter, or type its coordinates.`;
  }

  function told(text) {
    const fresh = JSON.parse(text);
    Object.assign(state, fresh);
    if ("quantities" in fresh) { options($("quantity"), fresh.quantities.map((q) => [q.name, q.said, q.lacks]), state.quantity); }
    if ("pseudolites" in fresh) { transmitters(); }
    if ("quantity" in fresh) { $("quantity").value = state.quantity; $("day").textContent = state.epoch; }
    if ("seconds" in fresh) { $("hours").value = state.seconds; $("clock").value = clock(state.seconds); $("listed").hidden = !state.listed; $("hours").disabled = state.listed; }
    if ("figures" in fresh || "exact" in fresh) { figures(); }
    if ("shares" in fresh) { shares(); }
    if ("map" in fresh) { about(fresh.map); }
    if ("warnings" in fresh) { $("warnings").replaceChildren(...fresh.warnings.map((w) => element("li", w))); }
    if ("unsaved" in fresh) { $("unsaved").hidden = !fresh.unsaved; $("undo").disabled = !fresh.undo; $("redo").disabled = !fresh.redo; }
    if ("problems" in fresh) { $("problems").replaceChildren(...fresh.problems.map((p) => element("li", p))); $("problems").hidden = !fresh.problems.length; }
    if ("asks" in fresh) { $("asked").hidden = !fresh.asks; $("asked").firstElementChild.textContent = fresh.asks; }
    if ("saved" in fresh) { $("said").hidden = !fresh.saved; $("said").textContent = fresh.saved; }
    if ("of" in fresh) { answered(fresh.of, fresh.map); }
    if (fresh.resting) { document.body.dataset.resting = "true"; }
  }

  function fit() {
    const room = Math.min(document.documentElement.clientWidth - (innerWidth > 1000 ? 660 : 150), innerHeight - 250);
    const size = Math.max(280, Math.min(760, room));
    if (figure.frame_width !== size) { figure.frame_width = size; figure.frame_height = size; }
  }

  function begin() {
    const found = (window.Bokeh.documents || [])[0];
    figure = found ? found.get_model_by_name("aerodrome") : null;
    if (!figure || begun) { if (!begun) { setTimeout(begin, 30); } return; }
    begun = true;
    [orders, news] = figure.tags;
    places = figure.renderers.map((r) => r.data_source).find((s) => s && s.data && s.data.marker);
    news.properties.data.change.connect(() => told(news.data.news[0]));
    const pick = () => settle({ do: "show", quantity: $("quantity").value, subject: Number($("subject").value) });
    $("quantity").addEventListener("change", pick);
    $("subject").addEventListener("change", pick);
    $("nearer").addEventListener("click", () => settle({ do: "area", factor: 0.5 }));
    $("farther").addEventListener("click", () => settle({ do: "area", factor: 2 }));
    $("add").addEventListener("click", () => settle({ do: "add" }));
    for (const what of ["undo", "redo"]) { $(what).addEventListener("click", () => settle({ do: what })); }
    $("save").addEventListener("click", () => send({ do: "save", consent: false }));
    $("replace").addEventListener("click", () => send({ do: "save", consent: true }));
    $("keep").addEventListener("click", () => { $("asked").hidden = true; });
    $("hours").addEventListener("input", () => { $("clock").value = clock(Number($("hours").value)); hurry({ do: "hasten", seconds: Number($("hours").value) }); });
    $("hours").addEventListener("change", () => settle({ do: "time", seconds: Number($("hours").value) }));
    $("clock").addEventListener("change", () => {
      const parts = $("clock").value.trim().match(/^(\d{1,2}):(\d{2})(?::(\d{2}(?:\.\d{1,3})?))?$/);
      const seconds = parts ? 3600 * parts[1] + 60 * parts[2] + Number(parts[3] || 0) : NaN;
      if (parts && Number(parts[1]) < 24 && Number(parts[2]) < 60 && Number(parts[3] || 0) < 60) { settle({ do: "time", seconds: seconds }); }
      else {
        told(JSON.stringify({ problems: [`${$("clock").value}: a time of day is needed, such as 12:00:00`] }));
        $("clock").value = clock(state.seconds);
      }
    });
    document.addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.target.matches("input")) { return; }
      const key = event.key.toLowerCase();
      const what = key === "z" && !event.shiftKey ? "undo" : key === "y" || key === "z" ? "redo" : null;
      if (what) { event.preventDefault(); settle({ do: what }); }
    });
    window.addEventListener("beforeunload", (event) => { if (state.unsaved) { event.preventDefault(); } });
    window.addEventListener("resize", fit);
    fit();
    send({ do: "hello" });
  }
  begin();
  return { pan: pan, state: state, trips: trips, places: () => places, figure: () => figure };
})();
