"""Two products times G, per channel: less than 6 KB a material."""

from brdfatlas.models.bagher2016.low_rank import LowRank, low_rank_parameters


class LowRankTwo(LowRank):
    """B of rank 2."""

    name = "low_rank_2"
    title = "Rank-2 table times G"
    status = "ours: weighted low-rank form of the model section 6 of the paper proposes"
    rank = 2
    parameters = low_rank_parameters(2)
