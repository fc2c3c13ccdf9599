// Elements of the page. Texts of a run become text nodes, never markup.

/** Return an element with attributes and children; children are elements or texts. */
export function element(name, attributes = {}, children = []) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Size a canvas to the element that holds it; return its context in CSS pixels with width and height. */
export function fitted(canvas, box) {
  const ratio = Math.min(devicePixelRatio || 1, 3);
  const [width, height] = [box.clientWidth, box.clientHeight];
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}
