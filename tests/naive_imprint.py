"""Plain loops against which the imprint is held."""

import numpy as np


def pairs_by_bin(vectors, is_chosen, edges_deg):
    """Ordered pairs of chosen positions by bin of angle (edge[k], edge[k + 1]]."""
    count = np.zeros(len(edges_deg) - 1)
    for i in range(len(vectors)):
        for j in range(len(vectors)):
            if i != j and is_chosen[i] and is_chosen[j]:
                angle = 2 * np.degrees(np.arcsin(np.linalg.norm(vectors[i] - vectors[j]) / 2))
                for k in range(len(count)):
                    count[k] += edges_deg[k] < angle <= edges_deg[k + 1]
    return count
