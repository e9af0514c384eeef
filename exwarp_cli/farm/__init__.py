"""Many machines: chunks of a sequence, job templates for render farms, and a cluster."""
