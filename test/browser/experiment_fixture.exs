defmodule ExperimentFixture do
  @moduledoc false
  # A study of two sessions with an experiment that has run: a level is compared with a limit. In the second session,
  # the level is half as high, so other limits are right there.
  alias Situ.{Dataset, Message, Metric, Store}

  @step 100_000_000

  defmodule Tune do
    @moduledoc false
    use Situ.Experiment

    @impl true
    def parameters, do: [limit: [1, 3, 5, 8], hold: {:time_ns, [0, 200_000_000]}]

    @impl true
    def build(_p, session, %{limit: limit}) do
      level = Situ.Experiment.stream(session, "Level")
      %{"Speaking" => Situ.map(level, &(&1 >= limit), type: :boolean)}
    end

    @impl true
    def metrics do
      [
        speaking: Metric.intervals(truth: "Speaking.Truth", main: :time_f1),
        segments: Metric.intervals(truth: "Speaking.Truth", stream: "Speaking")
      ]
    end
  end

  def create(folder) do
    file = Path.join(folder, "study.json")
    {:ok, dataset} = Dataset.new("Tuned study", file: file, autosave: true)

    dataset =
      for {session, height} <- [{"loud", 1.0}, {"quiet", 0.5}], reduce: dataset do
        dataset ->
          path = record(folder, session, height)
          {:ok, dataset} = Dataset.add_session(dataset, session)
          {:ok, dataset} = Dataset.add_partition(dataset, session, "Room", path)
          dataset
      end

    {:ok, _} = Situ.Experiment.Runner.run(Tune, dataset)
  end

  defp record(folder, name, height) do
    {:ok, writer} = Store.Writer.create(name, folder)
    numbers = for k <- 0..99, do: {Fixture.t0() + k * @step, rem(k, 10)}
    put(writer, "Level", :float, for({time, n} <- numbers, do: {time, n * height}))
    put(writer, "Speaking.Truth", :boolean, for({time, n} <- numbers, do: {time, n >= 5}))
    :ok = Store.Writer.close(writer)
    writer.path
  end

  defp put(writer, stream, type, values) do
    {:ok, out} = Store.Writer.stream(writer, stream, type: type)

    messages =
      for {{time, value}, n} <- Enum.with_index(values, 1),
          do: %Message{data: value, originating_time: time, sequence_id: n}

    {:ok, out} = Store.Writer.append(out, messages)
    {:ok, _} = Store.Writer.close_stream(out, Fixture.t0() + 99 * @step)
  end
end
