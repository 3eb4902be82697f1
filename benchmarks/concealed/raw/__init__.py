"""The raw tier: recordings as arms give them, by a generator of its own.

Motions, friction, sensors, effects, controller and arms are written apart from those of the other tiers, so that what
these have in common with the product is no help here. Every joint has friction that the URDF lacks, and the URDF's
inertials are off by 20 %; 30 s at 125 Hz to fit, another motion held out; one concealed effect, or none.

    python -m benchmarks.concealed generate --set development --tiers raw --count 48 --seed 0 -o DIR
    python -m benchmarks.concealed.raw.rank DIR -o OUT -j 2
    python -m benchmarks.concealed.raw.score OUT DIR
"""
