defmodule Situ.Conformance.Run do
  # Runs the inputs of a case through a pipeline.
  import Situ.Conformance.Case

  @long_ago_is_over 1_000_000_000_000_000

  # `build.(streams)` receives the input streams in the order of the case. Inputs that stay open,
  # or whose order of arrival matters, are fed singly into a waiting pipeline. The others run as
  # fast as possible.
  def inputs(case, build) do
    if Enum.any?(case["inputs"], &(&1["keep_open"] || &1["arrives_after_ms"])),
      do: in_turn(case["inputs"], build),
      else: at_once(case["inputs"], build)
  end

  def at_once(inputs, build) do
    named = for {input, i} <- Enum.with_index(inputs), do: {i, timed(input["messages"])}
    # The pipeline starts at 0, or with the first message if that is earlier.
    start = named |> Enum.flat_map(&elem(&1, 1)) |> Enum.reduce(0, &min(elem(&1, 0), &2))
    opts = [pipeline: [replay: [interval: {start, :unbounded}]]]
    guarded(fn -> Situ.Test.run(Map.new(named), &build.(in_order(&1)), opts) end)
  end

  # Sends entire inputs in sequence, the one that arrives first before the others.
  def in_turn(inputs, build) do
    indexed = Enum.with_index(inputs)

    waiting(inputs, build, @long_ago_is_over, fn test ->
      for {input, i} <- Enum.sort_by(indexed, fn {input, _} -> input["arrives_after_ms"] || 0 end) do
        Situ.Test.feed(test, i, timed(input["messages"]))
        unless input["keep_open"], do: Situ.Test.close(test, i)
      end

      # Outputs with clock times are emitted when the clock advances.
      Situ.Test.advance(test, ms(1))
    end)
  end

  # Sends the messages in the order of time, which is their order of arrival if none is late.
  def by_time(inputs, build) do
    all =
      for {input, i} <- Enum.with_index(inputs),
          {time, value} <- timed(input["messages"]),
          do: {time, i, value}

    waiting(inputs, build, @long_ago_is_over, fn test ->
      for {time, i, value} <- Enum.sort_by(all, fn {time, i, _} -> {time, i} end),
          do: Situ.Test.feed(test, i, {time, value})
    end)
  end

  # A pipeline with a clock that starts at `start`; `steps` advances it and feeds the pipeline.
  def waiting(inputs, build, start, steps) do
    guarded(fn ->
      keys = Enum.to_list(0..(length(inputs) - 1)//1)
      test = Situ.Test.start(keys, fn streams -> build.(in_order(streams)) end, start: start)
      steps.(test)
      outputs = Situ.Test.outputs(test)

      case Situ.Test.stop(test) do
        {:ok, _report} -> {:ok, outputs}
        {:error, error} -> {:error, error}
      end
    end)
  end

  def guarded(fun) do
    fun.()
  rescue
    error -> {:error, error}
  end

  defp in_order(streams), do: streams |> Enum.sort() |> Enum.map(&elem(&1, 1))
end
