"""Planning with twins: what hands should do so that a body comes to where a goal says, and what that does in another engine.

``controls`` are the paths that hands may take, ``mppi`` searches among them, ``goal`` and ``tasks/`` say what is wanted, ``cost`` what an
end is worth, ``planner`` puts them together for one twin. ``truth`` simulates bodies that no twin knows in an engine of its own;
``experiment`` fits twins there, plans with each, and scores what the plans truly do.
"""
