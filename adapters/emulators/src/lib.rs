//! Emulators of devices that speak the real protocols.
