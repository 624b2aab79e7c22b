// What is drawn on the canvas; each function draws a whole group in as few strokes as it can.

const MARK_RADIUS_PX = 4.5;
const LABEL_FONT = '11px "DejaVu Sans", Verdana, system-ui, sans-serif';

export function drawCircles(ctx, marks, colour, filled) {
  ctx.strokeStyle = ctx.fillStyle = colour;
  ctx.lineWidth = 1;
  for (const mark of marks) {
    ctx.beginPath();
    ctx.arc(mark.px, mark.py, mark.radiusPx, 0, 2 * Math.PI);
    if (filled) {
      ctx.globalAlpha = 0.1;
      ctx.fill();
    }
    ctx.globalAlpha = 0.45;
    ctx.stroke();
  }
  ctx.globalAlpha = 1;
}

export function drawTrail(ctx, points, colour, strong) {
  if (points.length < 2) return;
  ctx.beginPath();
  points.forEach(({ px, py }, i) => (i ? ctx.lineTo(px, py) : ctx.moveTo(px, py)));
  ctx.strokeStyle = colour;
  ctx.globalAlpha = strong ? 0.9 : 0.5;
  ctx.lineWidth = strong ? 2 : 1;
  ctx.stroke();
  ctx.globalAlpha = 1;
}

export function drawBeacons(ctx, points, colour) {
  ctx.beginPath();
  for (const { px, py } of points) {
    ctx.moveTo(px, py - 4);
    ctx.lineTo(px + 4, py + 3);
    ctx.lineTo(px - 4, py + 3);
    ctx.closePath();
  }
  ctx.fillStyle = colour;
  ctx.fill();
}

/** Marks of one status: disc, diamond or ring, each with a halo that parts it from its neighbours. */
export function drawMarks(ctx, marks, status, colours) {
  ctx.beginPath();
  for (const { px, py } of marks) (status === "stale" ? diamond : disc)(ctx, px, py);
  const ring = status === "offline";
  ctx.lineWidth = ring ? 2 : 1.5;
  ctx.fillStyle = ring ? colours.halo : colours[status];
  ctx.strokeStyle = ring ? colours.offline : colours.halo;
  ctx.fill();
  ctx.stroke();
}

function disc(ctx, px, py) {
  ctx.moveTo(px + MARK_RADIUS_PX, py);
  ctx.arc(px, py, MARK_RADIUS_PX, 0, 2 * Math.PI);
}

function diamond(ctx, px, py) {
  const reach = MARK_RADIUS_PX * 1.25;
  ctx.moveTo(px, py - reach);
  ctx.lineTo(px + reach, py);
  ctx.lineTo(px, py + reach);
  ctx.lineTo(px - reach, py);
  ctx.closePath();
}

export function drawSelection(ctx, { px, py }, colour) {
  ctx.beginPath();
  ctx.arc(px, py, MARK_RADIUS_PX + 5, 0, 2 * Math.PI);
  ctx.strokeStyle = colour;
  ctx.lineWidth = 2;
  ctx.stroke();
}

export function drawLabel(ctx, { px, py, name }, colours, strong) {
  ctx.font = strong ? `bold ${LABEL_FONT}` : LABEL_FONT;
  ctx.textBaseline = "middle";
  ctx.lineJoin = "round";
  ctx.lineWidth = 3;
  ctx.strokeStyle = colours.halo;
  ctx.fillStyle = colours.text;
  ctx.strokeText(name, px + 11, py);
  ctx.fillText(name, px + 11, py);
}
