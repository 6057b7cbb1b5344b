defmodule SensorStudy do
  @moduledoc """
  The results of the study: strides per session, and how well the sensors agree about the gait.

      {:ok, dataset} = Situ.Dataset.open("study.json")
      SensorStudy.strides(dataset)
  """
  alias Situ.Annotation.{Agreement, Layer, Recording}
  alias Situ.{Dataset, Error, Time}
  alias Situ.Dataset.{OpenSession, SessionLayers}

  @type strides :: %{
          session: String.t(),
          count: non_neg_integer(),
          mean: float(),
          deviation: float()
        }

  @doc """
  Returns one map for each session: the number of strides, and the mean and the standard deviation of their durations
  in seconds. A stride lasts from the beginning of a swing to the beginning of the next one.
  """
  @spec strides(Dataset.t()) :: [strides()]
  def strides(dataset) do
    for session <- dataset.sessions do
      starts = for swing <- swings(session), do: swing.from
      durations = Enum.zip_with(Enum.drop(starts, 1), starts, &Time.to_seconds(&1 - &2))
      mean = Enum.sum(durations) / length(durations)
      squares = for duration <- durations, do: (duration - mean) ** 2
      deviation = :math.sqrt(Enum.sum(squares) / (length(squares) - 1))
      %{session: session.name, count: length(durations), mean: mean, deviation: deviation}
    end
  end

  @doc "Returns the agreement of two sessions that recorded the same walk; see `Situ.Annotation.Agreement`."
  @spec agreement(Dataset.t(), String.t(), String.t()) :: Agreement.t()
  def agreement(dataset, first, second) do
    [a, b] =
      for name <- [first, second],
          do: dataset.sessions |> Enum.find(&(&1.name == name)) |> gait_layer()

    Error.unwrap!(Agreement.compare_layers(a, b, frame: Time.ms(10)))
  end

  @doc "Writes the table of strides as CSV and prints it."
  @spec report(Dataset.t(), Path.t()) :: :ok
  def report(dataset, path) do
    rows =
      for s <- strides(dataset),
          do: "#{s.session},#{s.count},#{Float.round(s.mean, 3)},#{Float.round(s.deviation, 3)}\n"

    table = ["session,strides,mean_s,deviation_s\n" | rows]
    File.write!(path, table)
    IO.puts(table)
  end

  defp swings(session), do: session |> gait_layer() |> Layer.annotations()

  # The layer that a person has corrected, or else the proposals of the task.
  defp gait_layer(session) do
    open = OpenSession.open(session)
    layers = Enum.filter(SessionLayers.list_layers(open), &(&1.stream =~ "Gait"))
    layer = Enum.find(layers, & &1.editable?) || hd(layers)
    {:ok, store} = OpenSession.fetch_store(open, layer.partition)
    Error.unwrap!(Recording.load_layer(store, layer.stream))
  end
end
