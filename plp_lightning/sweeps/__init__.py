"""SWEEPS: from one run to a thousand; each is a process of ``plp fit``, which this package starts and watches."""
