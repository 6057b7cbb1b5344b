defmodule Situ.Nx.MapComponent do
  @moduledoc false
  # The component of `Situ.Nx.map/3`. A function becomes a serving, so that all targets run batches in the same way.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [run: [type: :any, required: true, doc: false]]

  alias Situ.Nx.Conversion

  @impl true
  def init(opts) do
    {target, own} = opts[:run]
    {:ok, %{opts: own, run: runner(target, own), convert: own[:convert] || converter(target)}}
  end

  @impl true
  def handle_message(:in, message, context, state),
    do: handle_messages(:in, [message], context, state)

  @impl true
  def handle_messages(:in, messages, _context, state) do
    results =
      messages
      |> Enum.map(&state.convert.(&1.data))
      |> Enum.chunk_every(state.opts[:batch])
      |> Enum.flat_map(state.run)

    actions =
      for {message, result} <- Enum.zip(messages, results),
          do: {:out, message.originating_time, result}

    {actions, state}
  end

  # Servings convert their input themselves.
  defp converter(target) when is_function(target), do: &Conversion.to_nx/1
  defp converter(_serving), do: &Function.identity/1

  # Each runner is a function of a list of inputs that returns a list of results.
  defp runner(fun, opts) when is_function(fun, 1) do
    compiled = Nx.Defn.jit(fun, opts[:compiler])

    if opts[:batch] == 1,
      do: fn [input] -> [compiled.(input)] end,
      else: &run_stacked(compiled, &1, opts)
  end

  # A serving returns the result of one input, or a list of results.
  defp runner(%Nx.Serving{} = serving, _opts) do
    fn
      [input] -> [Nx.Serving.run(serving, input)]
      inputs -> Nx.Serving.run(serving, inputs)
    end
  end

  defp runner(name, _opts) when is_atom(name),
    do: fn inputs -> Enum.map(inputs, &Nx.Serving.batched_run(name, &1)) end

  defp run_stacked(compiled, tensors, opts) do
    count = length(tensors)
    missing = if opts[:pad], do: opts[:batch] - count, else: 0

    zeros =
      if missing > 0,
        do:
          List.duplicate(
            Nx.broadcast(0, hd(tensors)) |> Nx.as_type(Nx.type(hd(tensors))),
            missing
          ),
        else: []

    (tensors ++ zeros) |> Nx.stack() |> compiled.() |> split_rows(count)
  end

  # The result is a tensor, or a tuple or map of tensors.
  defp split_rows(result, count),
    do: for(row <- 0..(count - 1), do: pick_row(result, row))

  defp pick_row(%Nx.Tensor{} = tensor, row), do: tensor[row]

  defp pick_row(tuple, row) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.map(&pick_row(&1, row)) |> List.to_tuple()

  defp pick_row(%{} = map, row),
    do: Map.new(map, fn {key, value} -> {key, pick_row(value, row)} end)
end
