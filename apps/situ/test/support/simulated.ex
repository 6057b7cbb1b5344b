defmodule Situ.Fixture.Simulated do
  # Checks pipelines in a simulation.
  alias Situ.Pipeline

  @doc "Returns the messages of the pipeline's stream, `[{sequence_id, value}]`, and its result."
  def run(build) do
    {me, ref} = {self(), make_ref()}
    report = &send(me, {ref, &2.sequence_id, &1})
    spec = fn p -> p |> build.() |> Situ.each(report, async: true) end
    result = Pipeline.run(spec, pipeline: [max_restarts: 1_000])
    {drain(ref, []), result}
  end

  @doc "Raises unless the stream delivers all `values` once, in order."
  def check_values(build, values) do
    {seen, result} = run(build)
    all = Enum.with_index(values, &{&2 + 1, &1})
    unless match?({:ok, _report}, result) and seen == all, do: raise_unexpected(seen, result)
    :ok
  end

  @doc """
  Raises unless the stream delivers some of the increasing `values` once, in order. If two neighbours die, messages
  between them are lost.
  """
  def check_order(build, values) do
    {seen, result} = run(build)
    seen = for {_id, value} <- seen, do: value
    ordered? = seen == Enum.filter(values, &(&1 in seen))
    unless match?({:ok, _report}, result) and ordered?, do: raise_unexpected(seen, result)
    :ok
  end

  defp raise_unexpected(seen, result),
    do: raise("#{inspect(seen)} does not fit the result #{inspect(result, limit: 20)}")

  defp drain(ref, seen) do
    receive do
      {^ref, id, value} -> drain(ref, [{id, value} | seen])
    after
      0 -> Enum.reverse(seen)
    end
  end
end
