defmodule Situ.Operator do
  @moduledoc """
  Light operators: functions over the data of a stream that keep its times.

  A straight run of light operators runs in one process; inside it only the data changes, and one envelope is made at its
  end. An explicit `policy:` (other than `Situ.Delivery.synchronous/1`), `async: true`, a second consumer or a second input
  starts a new process.

  A step is

    * `{:map, fun}`: `fun.(data)` or `fun.(data, message)` gives the new data;
    * `{:filter, fun}`: passes data for which it is true;
    * `{:each, fun}`: called for its effect, passes the data on;
    * `{:step, fun, state}`: `fun.(data, message, state)` answers `{:emit, data, state}` or `{:skip, state}`.

  `message` is the message as it entered the chain (times, sequence id); its `data` is the data at that point.

      defmodule Tally do
        # Numbers the messages of a stream: {1, data}, {2, data}, ...
        def number(stream, opts \\\\ []) do
          step = fn data, _message, n -> {:emit, {n, data}, n + 1} end
          Situ.Operator.attach(stream, "Number", {:step, step, 1}, opts)
        end
      end

  ## Options of every operator

  #{Situ.Options.docs(name: [type: :string, doc: "The node's name; default the operator's."], type: [type: :any, doc: "Type of the output."], policy: [type: {:struct, Situ.Delivery}, doc: "Delivery policy of the input."], async: [type: :boolean, default: false, doc: "Give it a process of its own."], on_error: [type: {:in, [:stop, :skip, :restart]}, default: :stop, doc: "What a raising function does."])}
  """
  alias Situ.{Graph, Options, Stream}

  @type step ::
          {:map, fun()} | {:filter, fun()} | {:each, fun()} | {:step, fun(), state :: term()}

  @schema [
    name: [type: :string],
    type: [type: :any],
    policy: [type: {:optional, {:struct, Situ.Delivery}}],
    async: [type: :boolean, default: false],
    on_error: [type: {:in, [:stop, :skip, :restart]}, default: :stop]
  ]

  @doc "The schema of the options every operator takes, to merge into your own."
  @spec schema() :: Options.schema()
  def schema, do: @schema

  @doc """
  Adds a light operator behind `stream` and returns its output stream. `name` is its default name; `default_type` the
  output's type unless `type:` is given.
  """
  @spec attach(Stream.t(), String.t(), step(), keyword(), Situ.Type.t()) :: Stream.t()
  def attach(%Stream{} = stream, name, step, opts \\ [], default_type \\ :any) do
    check_step!(step)
    opts = Options.validate!(opts, @schema)
    type = opts[:type] || default_type
    spec = %{step: step, name: name, in_type: :any, out_type: type, opts: opts}

    stream.pipeline
    |> Graph.Builder.run(&Graph.add_operator(&1, stream, spec))
    |> Situ.Node.output(:out)
  end

  defp check_step!({kind, fun}) when kind in [:map, :filter, :each] and is_function(fun, 1),
    do: :ok

  defp check_step!({kind, fun}) when kind in [:map, :filter, :each] and is_function(fun, 2),
    do: :ok

  defp check_step!({:step, fun, _state}) when is_function(fun, 3), do: :ok

  defp check_step!(step) do
    raise ArgumentError,
          "not an operator step: #{inspect(step)}; the function takes (data), (data, message) or, for :step, (data, message, state)"
  end
end
