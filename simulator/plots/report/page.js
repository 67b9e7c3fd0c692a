"use strict";
const find = (selector, root = document) => root.querySelector(selector);
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const { psf } = JSON.parse(find("#data").textContent);
document.documentElement.classList.add("js"); // controls that need this script are shown from here on

// ---- frames of clips

function showFrame(card, number) {
  const slider = find(".frames input", card);
  for (const image of all("[data-frame]", card)) image.hidden = Number(image.dataset.frame) !== number;
  const time = find(`[data-frame="${number}"]`, card).dataset.time;
  slider.value = number;
  slider.setAttribute("aria-valuetext", time);
  find("output", card).value = time;
}

const playing = new Set();

function play(card, on) {
  const button = find(".play", card);
  if (on) playing.add(card);
  else playing.delete(card);
  button.firstChild.data = on ? "Pause" : "Play";
  const every = find("[data-every]");
  if (every) every.textContent = playing.size ? "Pause all clips" : "Play all clips";
  find("output", card).setAttribute("aria-live", on ? "off" : "polite"); // not five times a second
}

setInterval(() => {
  for (const card of playing) {
    const slider = find(".frames input", card);
    showFrame(card, (Number(slider.value) + 1) % (Number(slider.max) + 1));
  }
}, 200);

document.addEventListener("input", ({ target }) => {
  if (!target.matches(".frames input")) return;
  const card = target.closest(".card");
  play(card, false);
  showFrame(card, Number(target.value));
});

document.addEventListener("click", ({ target }) => {
  const button = target.closest(".play");
  if (!button) return;
  if (!("every" in button.dataset)) return play(button.closest(".card"), !playing.has(button.closest(".card")));
  const on = !playing.size;
  for (const slider of all(".cards .frames")) play(slider.closest(".card"), on);
});

// ---- one sample, large

const dialog = find("#large");
const cards = all(".cards .card");
let current = 0;

function stop(root) {
  for (const frames of all(".frames", root)) play(frames.closest(".card"), false);
}

function showLarge(number) {
  const stage = find(".stage", dialog);
  const inside = stage.contains(document.activeElement);
  stop(stage);
  current = (number + cards.length) % cards.length;
  stage.replaceChildren(cards[current].cloneNode(true));
  find(".open", stage).remove();
  stop(stage); // what was copied may have been playing
  const name = cards[current].getAttribute("aria-label");
  dialog.setAttribute("aria-label", `${name}, large`);
  if (dialog.open) find("output", dialog).value = name;
  else dialog.showModal();
  if (!inside) return;
  find(".play", stage)?.focus(); // what had the focus is gone
  if (!dialog.contains(document.activeElement)) find("button", dialog).focus();
}

cards.forEach((card, number) => find(".open", card).addEventListener("click", () => showLarge(number)));
dialog.addEventListener("click", ({ target }) => {
  if (target === dialog || "close" in target.dataset) dialog.close();
  else if ("step" in target.dataset) showLarge(current + Number(target.dataset.step));
});
dialog.addEventListener("close", () => stop(dialog));
dialog.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (step && !event.target.matches("input")) showLarge(current + step);
});

// ---- what a point source casts on the sensor

function explore() {
  const canvas = find(".explorer canvas");
  const context = canvas.getContext("2d");
  const images = all(".strip img");
  const control = (name) => find(`.controls [name="${name}"]`);
  const at = { depth: 0, row: psf.rows.length >> 1, column: psf.columns.length >> 1 };
  const names = { depth: psf.depths, row: psf.rowNames, column: psf.columnNames };

  function draw() {
    const weight = psf.weights ? psf.weights[at.row][at.column] : 1;
    const own = psf.whites[at.depth];
    const white = control("own")?.checked ? own : Math.max(...psf.whites);
    const scale = canvas.width / psf.sensor[1];
    context.globalAlpha = 1;
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.globalAlpha = Math.sqrt((weight * own) / white); // the images are square roots of light
    const left = psf.columns[at.column] - psf.origin[1];
    const top = psf.rows[at.row] - psf.origin[0];
    context.drawImage(images[at.depth], left * scale, top * scale, psf.size[1] * scale, psf.size[0] * scale);
    for (const name of Object.keys(at)) {
      const slider = control(name);
      if (!slider) continue;
      slider.value = at[name];
      slider.setAttribute("aria-valuetext", names[name][at[name]]);
      find("b", slider.parentNode).textContent = names[name][at[name]];
    }
    const source = find(".map circle");
    source.setAttribute("cx", psf.columns[at.column] + 0.5);
    source.setAttribute("cy", psf.rows[at.row] + 0.5);
    images.forEach((image, depth) => image.parentNode.classList.toggle("chosen", depth === at.depth));
    const light = psf.weights ? `Irradiance from here: ${weight.toFixed(2)} of the brightest direction's. ` : "";
    const scale_of = control("own") ? `${control("own").checked ? "this depth's own scale" : "one scale for all depths"}, ` : "";
    find(".controls output").value =
      `${light}White is ${white.toPrecision(2)} times the irradiance at the mask from the brightest direction, ` +
      `${scale_of}square-root stretch.`;
  }

  const nearest = (places, value) => places.reduce((best, place, number) =>
    Math.abs(place - value) < Math.abs(places[best] - value) ? number : best, 0);

  function drag(element, place) {
    const move = (event) => {
      if (!event.buttons) return;
      const { x, y } = place(event);
      Object.assign(at, { column: nearest(psf.columns, x), row: nearest(psf.rows, y) });
      draw();
    };
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      move(event);
    });
    element.addEventListener("pointermove", move);
  }

  drag(canvas, (event) => ({
    x: (event.offsetX / canvas.clientWidth) * psf.sensor[1] - 0.5,
    y: (event.offsetY / canvas.clientHeight) * psf.sensor[0] - 0.5,
  }));
  const map = find(".map svg");
  drag(map, (event) => {
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(map.getScreenCTM().inverse());
    return { x: place.x - 0.5, y: place.y - 0.5 };
  });
  find(".controls").addEventListener("input", ({ target }) => {
    if (target.name in at) at[target.name] = Number(target.value);
    draw();
  });
  images.forEach((image, depth) => image.addEventListener("click", () => {
    at.depth = depth;
    draw();
  }));
  Promise.all(images.map((image) => image.decode())).then(draw);
}

if (psf) explore();

// ---- the configuration

for (const button of all(".copy")) {
  button.addEventListener("click", async () => {
    const text = find("pre", button.parentNode);
    const say = find("output", button.parentNode);
    try {
      await navigator.clipboard.writeText(text.textContent);
      say.value = "Copied.";
    } catch { // a browser that lets no page write there
      getSelection().selectAllChildren(text);
      say.value = "Selected: copy it with the keyboard.";
    }
  });
}
