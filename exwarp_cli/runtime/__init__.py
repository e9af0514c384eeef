"""The process: its cores, memory, stops, compilation messages and open files."""
