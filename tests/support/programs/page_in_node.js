// Runs the script of a page with a canvas that records what is drawn; prints the drawings as JSON.
// Usage: node page_in_node.js PAGE ACTIONS, ACTIONS: JSON list of [element, property, value, event].
"use strict";
const text = require("fs").readFileSync(process.argv[2], "utf8");
const actions = JSON.parse(process.argv[3] || "[]");
const data = /<script type="application\/json" id="data">([^]*?)<\/script>/.exec(text)[1];
const code = /<script>([^]*?)<\/script>/.exec(text)[1];
let calls = [], listeners = {}, frames = [];
const pen = new Proxy({}, {
  get: (target, name) => (name in target ? target[name] : (...values) => calls.push([name, ...values])),
  set: (target, name, value) => { target[name] = value; calls.push(["set", name, value]); return true; },
});
const elements = {};
function element(id) {
  if (!elements[id]) {
    elements[id] = {
      id, textContent: id === "data" ? data : "", value: undefined, clientWidth: 800, clientHeight: 500, children: [],
      getContext: () => pen,
      addEventListener: (name, action) => { listeners[id + "." + name] = action; },
      appendChild(child) { this.children.push(child); if (child.selected) this.value = child.value; },
    };
  }
  return elements[id];
}
global.document = { getElementById: element, createElement: () => ({}) };
global.window = {
  devicePixelRatio: 1,
  addEventListener: (name, action) => { listeners["window." + name] = action; },
  requestAnimationFrame: (action) => frames.push(action),
};
new Function("document", "window", code)(global.document, global.window);
const drawings = [calls];
for (const [id, property, value, event] of actions) {
  calls = [];
  if (id === "frame") frames.shift()(value);
  else { if (property) element(id)[property] = value; listeners[id + "." + event](Object(value)); }
  drawings.push(calls);
}
const texts = Object.fromEntries(Object.values(elements).filter((e) => e.id !== "data").map((e) => [e.id, e.textContent]));
console.log(JSON.stringify({ drawings, texts, value: elements.slider.value }));
