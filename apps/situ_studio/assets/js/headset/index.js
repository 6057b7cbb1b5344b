// The page that is a headset: where head, hands and eyes are to a pipeline, and drawings from it.
import { Clock } from "../sensor/clock.js";
import { connect } from "../sensor/connection.js";
import { Moments } from "./moment.js";

const $ = (id) => document.getElementById(id);
const state = { sent: 0, dropped: 0, drawn: 0, offset: null, running: false };
window.situHeadset = state; // for tests and the console
const WANTED = ["hand-tracking", "plane-detection", "gaze-tracking", "eye-tracking"];
const drawing = () => import(new URL("assets/space.js", document.baseURI).href);
let stop = () => {};

const say = (text) => ($("status").textContent = text);

async function mode() {
  for (const mode of ["immersive-ar", "immersive-vr"]) if (await navigator.xr?.isSessionSupported(mode)) return mode;
  return null;
}

async function enter() {
  const session = await navigator.xr.requestSession(await mode(), {
    requiredFeatures: ["local-floor"],
    optionalFeatures: WANTED,
  });
  const parts = [{ stop: () => session.end().catch(() => {}) }];
  stop = (why) => {
    stop = () => {};
    for (const part of parts) part.stop();
    state.running = false;
    $("start").hidden = false;
    $("stop").hidden = true;
    say(why);
  };
  session.addEventListener("end", () => stop("The session has ended."));
  const { socket, credit } = await connect("headset/socket");
  parts.push({ stop: () => socket.close() });
  socket.onclose = ({ reason }) => stop(reason || "The pipeline has ended, or the connection was lost.");
  const clock = new Clock(socket, state);
  parts.push(clock);
  let room = credit;
  let drawings = null;
  const waiting = [];
  const draw = (data) => {
    const layer = drawings.put(data);
    state.drawn++;
    if (socket.readyState === 1) socket.send(JSON.stringify({ drawn: layer }));
  };
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return drawings ? draw(data) : waiting.push(data);
    const told = JSON.parse(data);
    if ("pong" in told) clock.pong(told);
    if ("credit" in told) room += told.credit;
  };
  const { openRoom } = await drawing();
  drawings = await openRoom(session, { frame, problem: (text) => say(text) });
  parts.push({ stop: () => drawings.close() });
  const moments = new Moments(session, await session.requestReferenceSpace("local-floor"));
  waiting.forEach(draw);

  function frame(time, xr) {
    if (state.offset === null || socket.readyState !== 1) return;
    if (room < 1) return void state.dropped++;
    const bytes = moments?.take(time, xr);
    if (!bytes) return;
    room--;
    socket.send(bytes);
    state.sent++;
  }

  state.running = true;
  $("start").hidden = true;
  $("stop").hidden = false;
  say("Running.");
}

const why = (error) =>
  error.name === "NotAllowedError" || error.name === "SecurityError"
    ? "The browser was not allowed to use the headset."
    : `It did not start: ${error.message}`;

const fail = (error) => {
  stop(why(error));
  say(why(error));
};

mode().then((found) => {
  $("start").disabled = !found;
  if (!found)
    say(
      window.isSecureContext
        ? "This browser knows no headset: open the page in the headset's own browser."
        : "This browser gives no headset here: open the page over https, or on the machine itself.",
    );
}, fail);
$("start").onclick = () => enter().catch(fail);
$("stop").onclick = () => stop("Stopped.");
