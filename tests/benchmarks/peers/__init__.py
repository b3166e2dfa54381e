"""Peers: other ways to solve the same drive, as good as an expert makes them in a day, to compare `fuser.map` with.

| peer          | what it is                                                                                    |
|---------------|-----------------------------------------------------------------------------------------------|
| gtsam_batch   | factor graph of the GTSAM library: IMU preintegration, GNSS position and velocity, robust loss |
| gtsam_scatter | the same with positions as exact as they scatter, not tuned for errors that last               |
| gtsam_untold  | that one with the noise that `fuser.map` begins with, and no lever arm                         |
| ekf_rts       | error-state Kalman filter of 21 states and Rauch-Tung-Striebel smoother, vehicle constraints   |

A peer is a function solve(drive) -> Estimate. It is told more than `fuser.map`, which knows the log alone: the true
attitude at the first sample, the size of the sensors' noise and the lever arm of the antenna (not gtsam_untold), and
the true mounting and place of the rear axle (ekf_rts). Where a peer is near to recon, it is so with these gifts.
"""
