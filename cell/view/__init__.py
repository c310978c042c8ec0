"""The view in the browser: taps the wire, shows what happens, passes on what an operator asks for."""
