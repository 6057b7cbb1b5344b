defmodule Situ.Examples.Scene.Histogram do
  @moduledoc """
  Counts values by bin and returns `{label, count}` rows for a bar chart.

      iex> alias Situ.Examples.Scene.Histogram
      iex> Histogram.new() |> Histogram.add_latency(Situ.Time.ms(3)) |> Histogram.latency_rows() |> Enum.take(3)
      [{"0", 0}, {"2", 1}, {"4", 0}]
  """
  alias Situ.PointCloud

  @bins [0, 2, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500]
  @step 0.2
  @top 2.8

  @type t :: %{optional(non_neg_integer()) => pos_integer()}

  @doc "Returns an empty histogram."
  @spec new() :: t()
  def new, do: %{}

  @doc "Adds one latency (ns)."
  @spec add_latency(t(), Situ.Time.duration()) :: t()
  def add_latency(counts, latency) do
    bin = @bins |> Enum.take_while(&(&1 * 1_000_000 <= latency)) |> List.last(0)
    Map.update(counts, bin, 1, &(&1 + 1))
  end

  @doc "Returns every bin with its count; the label is the lower bound in ms."
  @spec latency_rows(t()) :: [{String.t(), non_neg_integer()}]
  def latency_rows(counts), do: for(bin <- @bins, do: {"#{bin}", Map.get(counts, bin, 0)})

  @doc "Counts every fifth point of a cloud by height; the label is the lower bound in meters."
  @spec height_rows(PointCloud.t()) :: [{String.t(), non_neg_integer()}]
  def height_rows(%PointCloud{points: points}) do
    counts = count_heights(points, %{})

    for i <- 0..(round(@top / @step) - 1),
        do: {"#{Float.round(i * @step, 1)}", Map.get(counts, i, 0)}
  end

  defp count_heights(<<_::64, z::little-float-32, _::binary-size(48), rest::binary>>, counts),
    do: count_heights(rest, Map.update(counts, height_bin(z), 1, &(&1 + 1)))

  defp count_heights(_few, counts), do: counts

  # Clamps heights to the first and the last bin, so that points on the floor and the ceiling are counted.
  defp height_bin(z), do: z |> max(0.0) |> min(@top - 0.001) |> Kernel./(@step) |> floor()
end
