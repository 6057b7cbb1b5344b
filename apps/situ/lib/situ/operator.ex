defmodule Situ.Operator do
  @moduledoc false
  # Adds operators to streams. Light operators are functions on the data of a stream that preserve its times.
  #
  # A linear chain of light operators runs in one process. Within it only the data is passed on, and one envelope is
  # built at the end. An explicit `policy:` (other than `Situ.Delivery.synchronous/1` and `throttle(1)`), `async:
  # true`, a second consumer or a second input starts a new process.
  #
  # The possible steps are:
  #
  #   * `{:map, fun}`: `fun.(data)` or `fun.(data, message)` returns the new data;
  #   * `{:filter, fun}`: passes the data for which the function returns true;
  #   * `{:each, fun}`: calls the function for its side effect and passes the data on;
  #   * `{:step, fun, state}`: `fun.(data, message, state)` returns `{:emit, data, state}` or `{:skip, state}`.
  #
  # `message` is the message that entered the chain (with its times and sequence id); its `data` is the current data.
  alias Situ.{Graph, Node, Stream}
  alias Situ.Graph.{Builder, Placement}

  @type step ::
          {:map, fun()} | {:filter, fun()} | {:each, fun()} | {:step, fun(), state :: term()}

  @doc """
  Adds a light operator to `stream` and returns its output stream. `name` is its default name, and `default_type` is
  the output's type unless `type:` is given.
  """
  @spec attach(Stream.t(), String.t(), step(), keyword(), Situ.Type.t()) :: Stream.t()
  def attach(%Stream{} = stream, name, step, opts \\ [], default_type \\ :any) do
    check_step!(step)
    {[], opts} = Placement.split_options!(opts, [], :operator)
    type = opts[:type] || default_type
    spec = %{step: step, name: name, in_type: :any, out_type: type, opts: opts}

    stream.pipeline
    |> Builder.update_graph(&Graph.add_operator(&1, stream, spec))
    |> Node.output(:out)
  end

  @doc """
  Adds a component with one output, `:out`, to a stream (or `[input: stream, ...]`) and returns its output stream; for
  operators that need more than a step. `{module, own}` is the component with its own options. For the other arguments
  see `attach/5`.

  `policy:` may be a list here, with one policy for each input.
  """
  @spec attach_component(
          Stream.t() | keyword(Stream.t()),
          String.t(),
          {module(), keyword()},
          keyword(),
          Situ.Type.t()
        ) :: Stream.t()
  def attach_component(streams, name, component, opts \\ [], default_type \\ :any)

  def attach_component(%Stream{} = stream, name, component, opts, default_type),
    do: attach_component([in: stream], name, component, opts, default_type)

  def attach_component([{_, first} | _] = inputs, name, {module, own}, opts, default_type) do
    {policies, opts} = Keyword.pop(opts, :policy)
    {[], opts} = Placement.split_options!(opts, [], :operator)
    {type, opts} = Keyword.pop(opts, :type)
    ports = for {input, stream} <- inputs, do: {input, stream.type}
    placement = [inputs: ports, outputs: [out: type || default_type]]
    opts = own ++ placement ++ Keyword.put_new(opts, :default_name, name)
    handle = first.pipeline
    node = Builder.update_graph(handle, &Graph.add_component(&1, handle, module, opts))

    inputs
    |> Enum.zip(spread_policies(policies, length(inputs)))
    |> Enum.each(fn {{input, stream}, policy} ->
      Builder.update_graph(handle, &Graph.connect(&1, stream, node, input, policy: policy))
    end)

    Node.output(node, :out)
  end

  defp spread_policies(policies, n) when is_list(policies) and length(policies) == n, do: policies

  defp spread_policies(policies, n) when is_list(policies),
    do:
      raise(
        ArgumentError,
        "expected one policy per input, got #{length(policies)} policies for #{n} inputs"
      )

  defp spread_policies(policy, n), do: List.duplicate(policy, n)

  defp check_step!({kind, fun}) when kind in [:map, :filter, :each] and is_function(fun, 1),
    do: :ok

  defp check_step!({kind, fun}) when kind in [:map, :filter, :each] and is_function(fun, 2),
    do: :ok

  defp check_step!({:step, fun, _state}) when is_function(fun, 3), do: :ok

  defp check_step!(step) do
    raise ArgumentError,
          "not an operator step: #{inspect(step)}; the function takes (data), (data, message) or, " <>
            "for :step, (data, message, state)"
  end
end
