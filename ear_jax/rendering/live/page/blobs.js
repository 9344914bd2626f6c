// What the page carries beside its scripts: texts compressed by gzip, in base 64.

export async function unpack(id) {
  const text = document.getElementById(id).textContent;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Numbers in little-endian order, as WebAssembly has them too.
export async function unpackNumbers(id) {
  return new Float32Array((await unpack(id)).buffer);
}

// MuJoCo itself. Its module is imported from memory, so that the page works from a file and without a network.
export async function loadMuJoCo() {
  const [module, wasmBinary] = await Promise.all([unpack("mujoco-module"), unpack("mujoco-binary")]);
  const address = URL.createObjectURL(new Blob([module], { type: "text/javascript" }));
  const load = (await import(address)).default;
  URL.revokeObjectURL(address);
  return load({ wasmBinary, locateFile: (name) => name });
}
