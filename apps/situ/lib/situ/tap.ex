defmodule Situ.Tap do
  @moduledoc false
  # Taps on streams of a running pipeline, which can be attached and detached at any time (`Situ.attach_tap/3`). If the
  # pipeline is on another node, `LocalRunner` runs the function on the node of the process that attached the tap.
  alias Situ.Argument
  alias Situ.Pipeline.Client
  alias Situ.Tap.{LocalRunner, Sink}

  @enforce_keys [:pipeline, :id]
  defstruct [:pipeline, :id, :local_runner]

  @typedoc "`local_runner` is the process that runs the function, if the pipeline is on another node."
  @type t :: %__MODULE__{pipeline: pid(), id: pos_integer(), local_runner: pid() | nil}

  @schema [
    policy: [
      type: {:struct, Situ.Delivery},
      doc: "The delivery policy of its queue. Default: `Situ.Delivery.max_queue(1_000)`."
    ],
    name: [type: :string, doc: "The name of the tap in diagnostics. Default: \"Tap\"."]
  ]

  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  def attach(target, fun, opts) when is_function(fun, 1) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      {pipeline, port} = resolve_target(target)
      runner = if on_other_node?(pipeline), do: LocalRunner.start(fun)
      options = if runner, do: [to: runner], else: [fun: fun]
      request = %{stream: port, component: {Sink, options}, opts: opts}

      case Client.call(pipeline, {:tap, request}) do
        {:ok, {pid, id}} ->
          if runner, do: LocalRunner.watch_pipeline(runner, pid)
          {:ok, %__MODULE__{pipeline: pid, id: id, local_runner: runner}}

        error ->
          if runner, do: LocalRunner.stop(runner)
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

  def detach(%__MODULE__{} = tap) do
    if tap.local_runner, do: LocalRunner.stop(tap.local_runner)

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
