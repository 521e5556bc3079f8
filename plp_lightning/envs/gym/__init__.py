"""GYM: any environment of Gymnasium as a simulator; its episodes are shared out to processes."""
