defmodule Situ.Experiment.Test.LevelStudy do
  @moduledoc false
  # A dataset of sessions with a noisy level and the truth, whether somebody speaks. The noise grows with the session.
  import Situ.Dataset.Test.Study, only: [record: 3]
  alias Situ.Dataset.{Partition, Session}

  @step 50_000_000

  @doc "Creates `root/study.json` with `n` sessions p1..pn of ten seconds."
  def create_dataset(root, n) do
    {:ok, dataset} = Situ.Dataset.new("Study", file: Path.join(root, "study.json"))

    dataset =
      Enum.reduce(1..n, dataset, fn i, dataset ->
        {:ok, dataset} = Situ.Dataset.add_session(dataset, session(root, i))
        dataset
      end)

    {:ok, dataset} = Situ.Dataset.save(dataset)
    dataset
  end

  defp session(root, i) do
    start = i * 1_000_000_000_000
    folder = Path.join(root, "p#{i}")
    times = for k <- 0..199, do: {k, start + k * @step}
    level = for {k, time} <- times, do: {time, if(speaks?(k), do: 0.6, else: 0.2) + noise(k, i)}
    truth = for {k, time} <- times, do: {time, speaks?(k)}
    room = Partition.new("Room", record(folder, "room", %{"Level" => level}))
    true_values = Partition.new("Truth", record(folder, "truth", %{"Speaking.Truth" => truth}))
    tags = if i > 2, do: ["noisy"], else: []

    {:ok, session} =
      Session.add_partition(Session.new("p#{i}", metadata: %{"noise" => i}, tags: tags), room)

    {:ok, session} = Session.add_partition(session, true_values)
    session
  end

  defp speaks?(k), do: k in 40..79 or k in 120..149

  # The same numbers in every run.
  defp noise(k, i), do: 0.04 * i * :math.sin(k * 12.9898 + i * 78.233)
end
