// @ts-check
/** What robots' cameras saw along their rollouts: small pictures in a corner, the one of the moment that is shown. */
(() => {
  "use strict";
  const { sheet } = window.desirePath;
  const panel = document.createElement("div");
  panel.id = "desire-path-pictures";

  /** @typedef {{given: Orders["replay"]["pictures"][number], image: HTMLImageElement, canvas: HTMLCanvasElement, shown: number}} Picture */
  /** @type {Picture[]} */
  let pictures = [];

  /** @param {Picture} picture @param {number} number */
  function draw(picture, number) {
    const { given, image, canvas } = picture;
    const brush = canvas.getContext("2d");
    if (number === picture.shown || !image.complete || !image.naturalWidth || !brush) return;
    const [left, top] = [given.width * (number % given.across), given.height * Math.floor(number / given.across)];
    brush.drawImage(image, left, top, given.width, given.height, 0, 0, given.width, given.height);
    picture.shown = number;
    canvas.dataset.number = String(number);
  }

  window.desirePath.pictures = {
    /** Show these from now on. @param {Orders["replay"]["pictures"]} sheets */
    use(sheets) {
      pictures = sheets.map((given) => {
        const image = new Image();
        image.src = given.image;
        const canvas = document.createElement("canvas");
        canvas.width = given.width;
        canvas.height = given.height;
        return { given, image, canvas, shown: -1 };
      });
      panel.replaceChildren(
        ...pictures.map(({ given, canvas }) => {
          const figure = document.createElement("figure");
          const caption = document.createElement("figcaption");
          const robot = document.createElement("i");
          robot.style.background = `rgb(${given.colour.join(" ")})`;
          caption.append(robot, given.caption);
          canvas.setAttribute("role", "img");
          canvas.setAttribute("aria-label", `${given.name}: ${given.caption}`);
          figure.append(canvas, caption);
          return figure;
        }),
      );
      if (pictures.length) sheet.element.append(panel);
      else panel.remove();
    },

    /** The pictures of that moment. @param {number} t seconds since the rollouts began */
    at(t) {
      for (const picture of pictures) {
        const last = picture.given.count - 1;
        draw(picture, Math.min(last, Math.max(0, Math.floor(t / picture.given.every_s))));
      }
    },
  };
})();
