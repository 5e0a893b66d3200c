// Whether this browser draws in 3D.

let known = null;

/** Whether it has WebGL 2; without the hardware a browser may support it and still refuse. */
export function hasWebGl() {
  if (known !== null) return known;
  const gl = document.createElement("canvas").getContext("webgl2");
  known = gl !== null;
  // Browsers keep only a few contexts alive.
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return known;
}
