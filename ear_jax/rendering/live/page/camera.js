// The camera that follows the robot, and its perspective.

const ELEVATION = { runs: .16, roams: .62, fixed: .3 };  // radians
const FIELD = .62;  // radians from top to bottom
const NEAR = .2;  // metres

// Frames the robot of a view for a picture of a width and height.
export function makeCamera(view) {
  const kind = view.locomotion, elevation = ELEVATION[kind];
  const forward = Math.atan2(view.forward[0], view.forward[1]);  // clockwise from y
  const camera = { kind, at: [...view.centre], speed: [0, 0], last: [...view.centre], lift: 0, width: 1, height: 1 };
  const [cos, sin] = [Math.cos(elevation), Math.sin(elevation)], [c, s] = [Math.cos(forward), Math.sin(forward)];
  const right = [c, -s, 0], ahead = [cos * s, cos * c, -sin], up = [sin * s, sin * c, cos];
  camera.basis = { right, up, ahead };

  camera.resize = (width, height) => {
    const tall = kind === "roams" ? 2.9 * view.length : Math.max(1.7 * view.top, 2.2 * view.length * height / width);
    camera.distance = tall / (2 * Math.tan(FIELD / 2));
    camera.focus = height / (2 * Math.tan(FIELD / 2));
    [camera.width, camera.height] = [width, height];
    // The ground is in the lower part of the picture, unless the robot stands up.
    camera.tall = tall;
    camera.ground = kind === "runs" ? .42 * tall : kind === "roams" ? .25 * view.top : view.centre[2];
    camera.at[2] = camera.ground + (kind === "runs" ? camera.lift : 0);
  };
  // Follows the robot's place without shaking with it; `top` is its highest point, `seconds` are those since the last call.
  camera.follow = (place, top, seconds) => {
    if (kind === "fixed" || seconds <= 0) return;
    [0, 1].forEach((axis) => {
      camera.speed[axis] += ((place[axis] - camera.last[axis]) / seconds - camera.speed[axis]) * (1 - Math.exp(-5 * seconds));
      camera.at[axis] += camera.speed[axis] * seconds + (place[axis] - camera.at[axis]) * (1 - Math.exp(-5 * seconds));
    });
    camera.last = [...place];
    const wanted = Math.max(0, top + .12 * camera.tall - camera.ground - camera.tall / 2);
    camera.lift += (wanted - camera.lift) * (1 - Math.exp(-3 * seconds));
  };
  camera.jump = (place) => {
    if (kind === "fixed") return;
    [camera.at[0], camera.at[1], camera.speed, camera.last, camera.lift] = [place[0], place[1], [0, 0], [...place], 0];
  };

  // A place in the world on the picture: x, y, pixels per metre there, and the distance; null behind the camera.
  camera.project = (point) => {
    const away = point.map((part, axis) => part - camera.at[axis]);
    const depth = product(away, ahead) + camera.distance;
    if (depth < NEAR) return null;
    const scale = camera.focus / depth;
    return [camera.width / 2 + scale * product(away, right), camera.height / 2 - scale * product(away, up), scale, depth];
  };
  // The place in the world that is at a point of the picture and as far away as `depth`.
  camera.unproject = (x, y, depth) => {
    const scale = camera.focus / depth;
    const [across, high, deep] = [(x - camera.width / 2) / scale, (camera.height / 2 - y) / scale, depth - camera.distance];
    return [0, 1, 2].map((axis) => camera.at[axis] + across * right[axis] + high * up[axis] + deep * ahead[axis]);
  };
  camera.horizon = () => camera.height / 2 - camera.focus * Math.tan(elevation);
  return camera;
}
const product = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
