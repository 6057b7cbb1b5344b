defmodule Situ.Pipeline.Tap do
  @moduledoc """
  A tap on a stream of a running pipeline, which can be attached and detached at any time; see `Situ.attach_tap/3`.

  The function runs in its own process, which has a lossy queue (default `Situ.Delivery.max_queue(1_000)`), so a slow
  or stuck tap costs the pipeline only the copying of messages. If the function raises, the message is skipped. The
  tap ends with its pipeline and with the process that attached it. The function runs on the node of the process that
  attached the tap. If the pipeline is on another node, one message at a time is in flight.

      iex> me = self()
      iex> connector = Situ.Connector.new("taps")
      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.Connector.receive(connector) |> Situ.map(&(&1 * 2), name: "Doubled")
      ...> end, [])
      iex> {:ok, tap} = Situ.attach_tap({p, "Doubled"}, &send(me, {:seen, &1.data}))
      iex> Situ.Connector.deliver_messages(connector, [%Situ.Message{data: 21, originating_time: 1}])
      iex> receive do {:seen, n} -> n end
      42
      iex> Situ.Pipeline.Tap.detach(tap)
      :ok
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> Situ.Pipeline.Tap.detach(tap)
      :ok
  """
  alias Situ.Argument
  alias Situ.Pipeline.Client
  alias Situ.Pipeline.Tap.{LocalRunner, Sink}

  @enforce_keys [:pipeline, :id]
  defstruct [:pipeline, :id, :here]

  @typedoc "`here` is the process that runs the function, if the pipeline is on another node."
  @type t :: %__MODULE__{pipeline: pid(), id: pos_integer(), here: pid() | nil}

  @schema [
    policy: [
      type: {:struct, Situ.Delivery},
      doc: "The delivery policy of its queue. Default: `Situ.Delivery.max_queue(1_000)`."
    ],
    name: [type: :string, doc: "The name of the tap in diagnostics. Default: \"Tap\"."]
  ]

  @doc false
  def option_schema, do: @schema

  @doc false
  @spec attach(
          Situ.Stream.t() | {Situ.Pipeline.target(), String.t()},
          (Situ.Message.t() -> any()),
          keyword()
        ) ::
          {:ok, t()} | {:error, Situ.Error.t()}
  def attach(target, fun, opts) when is_function(fun, 1) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      {pipeline, which} = resolve_target(target)
      here = if on_other_node?(pipeline), do: LocalRunner.start(fun)
      options = if here, do: [to: here], else: [fun: fun]
      asked = %{stream: which, component: {Sink, options}, opts: opts}

      case Client.call(pipeline, {:tap, asked}) do
        {:ok, {pid, id}} ->
          if here, do: LocalRunner.watch_pipeline(here, pid)
          {:ok, %__MODULE__{pipeline: pid, id: id, here: here}}

        error ->
          if here, do: LocalRunner.stop(here)
          error
      end
    end
  end

  def attach(_target, other, _opts) do
    takes = "a function of a message as its second argument"
    Argument.raise_invalid!(other, takes, "Situ.attach_tap(stream, fn message -> message end)")
  end

  defp on_other_node?(pipeline) do
    pid = Client.resolve_pid(pipeline)
    is_pid(pid) and node(pid) != node()
  end

  @doc "Removes the tap. Does nothing if its pipeline has already ended."
  @spec detach(t()) :: :ok
  def detach(%__MODULE__{} = tap) do
    if tap.here, do: LocalRunner.stop(tap.here)

    case Client.call(tap.pipeline, {:untap, tap.id}) do
      :ok -> :ok
      {:error, %Situ.Error{code: :not_running}} -> :ok
    end
  end

  def detach(other) do
    takes = "a tap, as Situ.attach_tap/3 returns it"

    Argument.raise_invalid!(
      other,
      takes,
      "{:ok, tap} = Situ.attach_tap(...), then Situ.detach_tap(tap)"
    )
  end

  defp resolve_target(%Situ.Stream{} = stream), do: {stream, {stream.node, stream.output}}
  defp resolve_target({pipeline, name}) when is_binary(name), do: {pipeline, name}

  defp resolve_target(other) do
    takes = "a stream, or {pipeline, name_of_a_stream}"

    Argument.raise_invalid!(
      other,
      takes,
      ~s|Situ.attach_tap({p, "Front"}, fn message -> message end)|
    )
  end
end
