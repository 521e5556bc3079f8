"""PLP-T from source demonstrations without actions."""
