defmodule Situ.Infer.Voice.Energy do
  @moduledoc false
  # Converts the level above the noise floor to a probability. The floor falls immediately and rises slowly. Speech
  # does not raise it, because speech has pauses; steady noise becomes the floor within a few seconds.
  @behaviour Situ.Infer.Voice.Detector

  @chunk_s 0.032
  @quietest_db -70.0

  defstruct [:floor_db, :rise_db_per_s, :above_db]

  @impl true
  def load(opts),
    do: {:ok, %__MODULE__{rise_db_per_s: opts[:rise_db_per_s], above_db: opts[:above_db]}}

  @impl true
  def reset(energy), do: %{energy | floor_db: nil}

  @impl true
  def step(energy, _chunk, level) do
    db = max(20 * :math.log10(max(level, 1.0e-6)), @quietest_db)
    # The noise is unknown at the start, so the first level is taken as the floor.
    floor = min(db, (energy.floor_db || db) + energy.rise_db_per_s * @chunk_s)
    p = Situ.Infer.Activation.sigmoid((db - floor - energy.above_db) / 2.0)
    {:ok, p, %{energy | floor_db: floor}}
  end
end
