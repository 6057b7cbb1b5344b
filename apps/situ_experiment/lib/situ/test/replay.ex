defmodule Situ.Test.Replay do
  @moduledoc """
  Golden tests for pipelines: a replay of a recording must give the same results as before.

      defmodule Lobby.ReplayTest do
        use ExUnit.Case
        import Situ.Test.Replay

        test "voices are found as in the recording" do
          assert_replays_like("test/data/lobby.0000", fn _p, recording ->
            %{"Speaking" => recording |> Situ.Store.stream("Level") |> Situ.map(&(&1 > 0.5))}
          end)
        end
      end

  The recording contains the inputs and the expected outputs. The function receives the pipeline and the opened
  recording (`Situ.Store.importer/3`), and returns streams by the names of the recorded streams that they must equal.
  """
  alias Situ.Experiment.StreamDiff
  alias Situ.{Collector, Error, Options, Pipeline, Store}

  @compile {:no_warn_undefined, ExUnit.AssertionError}

  @options [
    tolerances: [
      type: :map,
      default: %{},
      doc:
        "The largest difference of numbers in the data, by stream: `%{\"Level\" => 1.0e-6}`. Other streams must be " <>
          "equal. Originating times are always equal."
    ]
  ]

  @doc """
  Replays a recording through a pipeline and fails if a stream differs from the recorded one. The failure names each
  stream with its first difference. Returns `:ok`.

  #{Options.docs(@options)}
  """
  @spec assert_replays_like(
          Path.t() | Store.t(),
          (Pipeline.t(), Store.Importer.t() -> %{String.t() => Situ.Stream.t()}),
          keyword()
        ) :: :ok
  def assert_replays_like(recording, build, opts \\ []) when is_function(build, 2) do
    opts = Options.validate!(opts, @options)
    store = if is_binary(recording), do: Store.open!(recording), else: recording

    case replay_streams(store, build) do
      {:ok, streams} -> check_streams(store, streams, opts[:tolerances])
      {:error, error} -> fail_test("the replay failed: #{Exception.message(error)}")
    end
  end

  defp replay_streams(store, build) do
    Collector.collect(fn p -> build.(p, Store.importer(p, store)) end,
      pipeline: [replay: [speed: :max]]
    )
  end

  defp check_streams(store, streams, tolerances) do
    differences =
      for {name, messages} <- Enum.sort(streams),
          why = compare_recorded(store, name, messages, tolerances[name]),
          do: "  #{name}: #{why}"

    if differences == [],
      do: :ok,
      else: fail_test("the replay differs from the recording\n" <> Enum.join(differences, "\n"))
  end

  defp compare_recorded(store, name, messages, tolerance) do
    case Store.stream_info(store, name) do
      {:ok, info} ->
        StreamDiff.compare_messages(Store.messages(store, info.name), messages, tolerance)

      {:error, error} ->
        Error.message(error)
    end
  end

  defp fail_test(text), do: raise(ExUnit.AssertionError, message: text)
end
