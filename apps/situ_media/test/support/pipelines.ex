defmodule Situ.Media.TestPipelines do
  @moduledoc "Runs a pipeline and returns the messages of its streams."

  @doc """
  Runs `build`, which returns a map of streams. Returns the result of the run and, for each key, `[{originating_time,
  data}]`.
  """
  def collect(build, opts \\ []) do
    {:ok, agent} = Agent.start_link(fn -> %{} end)

    result =
      Situ.Pipeline.run(
        fn p ->
          for {key, stream} <- build.(p), stream != nil do
            Situ.each(stream, fn data, message ->
              Agent.update(agent, &put(&1, key, {message.originating_time, data}))
            end)
          end
        end,
        opts
      )

    messages = Agent.get(agent, & &1)
    Agent.stop(agent)
    {result, Map.new(messages, fn {key, list} -> {key, Enum.reverse(list)} end)}
  end

  @doc """
  Starts `build` as a live pipeline, waits until every stream in the returned map has emitted the number of messages
  given in `counts`, and stops the pipeline. Returns the messages for each key.
  """
  def collect_live(build, counts, opts \\ []) do
    test = self()

    {:ok, pid} =
      Situ.Pipeline.start(
        fn p ->
          for {key, stream} <- build.(p) do
            Situ.each(stream, fn data, message ->
              send(test, {:live, key, message.originating_time, Situ.Pipeline.now(p), data})
            end)
          end
        end,
        opts
      )

    got = wait(counts, %{})
    Situ.Pipeline.stop(pid)
    got
  end

  defp wait(counts, got) do
    if Enum.all?(counts, fn {key, n} -> length(Map.get(got, key, [])) >= n end) do
      Map.new(got, fn {key, list} -> {key, Enum.reverse(list)} end)
    else
      receive do
        {:live, key, time, now, data} -> wait(counts, put(got, key, {time, now, data}))
      after
        20_000 -> raise "only got #{inspect(Map.new(got, fn {k, l} -> {k, length(l)} end))}"
      end
    end
  end

  defp put(map, key, item), do: Map.update(map, key, [item], &[item | &1])
end
