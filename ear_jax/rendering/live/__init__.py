"""The live page of `ear explore`: physics and policy run in the browser, on MuJoCo's own WebAssembly."""
