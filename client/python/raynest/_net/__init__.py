"""To the daemon: addresses, sockets, TLS, ssh, frames, control messages, and the connection that uses them."""
