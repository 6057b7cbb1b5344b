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

  @doc """
  Raises unless the stream delivers all `values` once, in order. A pipeline whose sources have ended restarts nothing:
  if a component is killed then, the values up to some point suffice, and the pipeline fails.
  """
  def check_values(build, values) do
    {seen, result} = run(build)
    all = Enum.with_index(values, &{&2 + 1, &1})

    case result do
      {:ok, _report} when seen == all -> :ok
      {:error, %{code: :component_killed}} -> check_prefix(seen, all)
      other -> raise "#{inspect(seen)} does not fit the result #{inspect(other, limit: 20)}"
    end
  end

  defp check_prefix(seen, all) do
    if seen != Enum.take(all, length(seen)), do: raise("not a prefix: #{inspect(seen)}")
    :ok
  end

  defp drain(ref, seen) do
    receive do
      {^ref, id, value} -> drain(ref, [{id, value} | seen])
    after
      0 -> Enum.reverse(seen)
    end
  end
end
