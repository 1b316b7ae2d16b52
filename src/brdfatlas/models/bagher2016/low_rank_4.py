"""Four products times G, per channel: less than 10 KB a material."""

from brdfatlas.models.bagher2016.low_rank import LowRank, low_rank_parameters


class LowRankFour(LowRank):
    """B of rank 4."""

    name = "low_rank_4"
    title = "Rank-4 table times G"
    status = "ours: weighted low-rank form of the model section 6 of the paper proposes"
    rank = 4
    parameters = low_rank_parameters(4)
