"""Scores of gesture motion and gesture video, each named after the source of its definition.

Motion scores take arrays of points `(T, n, D)`: region centres, or any joints; `fps` is always an
argument. Image scores take frames in [0, 1]. Every score is a `Score`: a value with the counts
behind it, or the reason why there is none.

| module | scores |
|---|---|
| `frechet` | Frechet distance, feature and raw space |
| `autoencoder` | the auto-encoder whose features FGD compares |
| `beats` | beat consistency (HA2G), matched beats (Rhythmic Gesticulator), Beat Align |
| `diversity` | diversity (HA2G, across clips, pairwise), lexeme entropy |
| `speed` | jerk, acceleration, Hellinger distance of speed histograms |
| `truth` | MAJE, MAD, CCA: distance to the motion that was recorded |
| `images` | AED, AKD, MKR, flicker; L1, perceptual, SSIM, PSNR are in `mraa.perceptual` |
| `identity` | the network behind AED |
"""
