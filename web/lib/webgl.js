// Whether this browser draws in 3D.

let known = null;

/** Whether it has WebGL 2; without hardware for it, it may know of it and still refuse. */
export function hasWebGl() {
  if (known !== null) return known;
  const gl = document.createElement("canvas").getContext("webgl2");
  known = gl !== null;
  // Browsers keep only some of them alive.
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return known;
}
