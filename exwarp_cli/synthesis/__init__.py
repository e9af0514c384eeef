"""What a slot's frame is made by."""
