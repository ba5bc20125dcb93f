"""Benchmarks: methods side by side on scenes, their errors and times, and the plots, tables and files of these.

what is compared   ``methods``, ``metrics`` (errors), ``timing`` (clocks)
one scene          ``race`` (one method against the clock), ``duel`` (several of them)
a series           ``suite`` (scenes), ``scaling`` (triangles), ``tradeoff`` (tolerances), ``convergence`` (samples),
                   ``equal_error`` (lights)
what is written    ``results`` (JSON), ``report`` (HTML), ``plotting`` (PNG), ``gallery`` (pictures of scenes)
"""
