// A command with a button that copies it.

import { element } from "./dom.js";

/** Return the elements of a command: {block, show}, where `show(text)` replaces it. */
export function commandBlock(title, text) {
  const shown = element("pre", { tabindex: "0", id: "command" }, [text]);
  const button = element("button", { type: "button" }, ["Copy"]);
  button.addEventListener("click", async () => {
    // A page that was opened from a disk may not be allowed to copy; then the text is selected.
    getSelection().selectAllChildren(shown);
    try {
      await navigator.clipboard.writeText(shown.textContent);
      button.textContent = "Copied";
    } catch {
      button.textContent = "Selected";
    }
  });
  const show = (next) => {
    shown.textContent = next;
    button.textContent = "Copy";
  };
  const line = element("div", { class: "line" }, [element("h3", {}, [title]), button]);
  return { block: element("div", { class: "wide command" }, [line, shown]), show };
}
