"""Files in and out: result store, almanacs."""
