// Elements of the page. Texts of a run become text nodes, never markup.

/** Return an element with attributes and children; children are elements or texts. */
export function element(name, attributes = {}, children = []) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Return the heading of a chart; a remark follows in brackets, smaller. */
export function heading(title, remark = "") {
  const made = element("h3", {}, [title]);
  if (remark) made.append(" ", element("small", {}, [`(${remark})`]));
  return made;
}

/**
 * Add the frame of a chart to a room: a caption, a list of entries, and a plot with a canvas. `still` charts do not
 * move the time. Returns {figure, legend, plot, canvas}.
 */
export function chartFrame(room, id, caption, still = true) {
  const canvas = element("canvas", { role: "img" });
  const plot = element("div", { class: still ? "plot still" : "plot" }, [canvas]);
  const legend = element("ul", { class: "legend" });
  const figure = element("figure", { class: "chart", "data-id": id }, [
    element("figcaption", {}, caption),
    legend,
    plot,
  ]);
  room.append(figure);
  return { figure, legend, plot, canvas };
}

/**
 * Draw a view when its element comes into sight or changes its size, and, while it is in sight, at every row: what
 * nobody sees costs nothing. `resize` is called before the first drawing and after every change of the size.
 */
export function follow(box, player, { resize, draw }) {
  let visible = false;
  const measure = () => {
    if (!box.clientWidth) return;
    resize();
    draw(player.row);
  };
  new IntersectionObserver((entries) => {
    visible = entries[entries.length - 1].isIntersecting;
    if (visible) draw(player.row);
  }, { rootMargin: "100px" }).observe(box);
  addEventListener("beforeprint", () => draw(player.row));
  new ResizeObserver(measure).observe(box);
  player.onRow((row) => visible && draw(row));
  measure();
}

/** Draw a view with a `canvas` in a `plot` as a whole at every row, in another theme and at another `size`. */
export function drawWhole(view, theme, player) {
  theme.onChange(() => view.draw());
  const resize = () => {
    view.size = fitted(view.canvas, view.plot);
  };
  follow(view.plot, player, { resize, draw: () => view.draw() });
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
