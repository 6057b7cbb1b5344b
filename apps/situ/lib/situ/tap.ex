defmodule Situ.Tap do
  @moduledoc """
  A point in a running pipeline that any process can subscribe to.

      {level, tap} = Situ.Tap.new(level)
      ...
      :ok = Situ.Tap.subscribe(tap)
      receive do
        {:situ_tap, ^tap, message} -> IO.inspect(message.data)
      end

  A subscriber receives `{:situ_tap, tap, message}` for each message from then on, and `{:situ_tap_end, tap, how}`
  after the last message. `how` is `{:closed, time}`, or the `Situ.Error` that ended the pipeline. A subscriber
  receives nothing after it has unsubscribed or ended. Subscribers do not slow the pipeline down: a subscriber misses
  messages while more than `max_queue:` messages (default 10,000) are waiting in its mailbox.
  """

  alias Situ.{Argument, Operator, Stream}
  alias Situ.Graph.Placement

  @schema [
    max_queue: [
      type: :pos_integer,
      default: 10_000,
      doc: "A subscriber with more waiting messages than this misses messages."
    ]
  ]

  @enforce_keys [:ref]
  defstruct [:ref]

  @type t :: %__MODULE__{ref: reference()}

  defmodule Component do
    @moduledoc false
    use Situ.Component,
      inputs: [in: :any],
      outputs: [out: :any],
      options: [
        tap: [type: :any, required: true],
        max_queue: [type: :pos_integer, required: true]
      ]

    @impl true
    def init(opts), do: {:ok, {opts[:tap], opts[:max_queue], :open}}

    @impl true
    def handle_message(_input, message, _context, {tap, limit, _} = state) do
      for {pid, _} <- Registry.lookup(Situ.Tap, tap.ref), mailbox_room?(pid, limit) do
        send(pid, {:situ_tap, tap, message})
      end

      {[{:out, message.originating_time, message.data}], state}
    end

    # The reason for the end comes from the pipeline, because a pipeline fails as a whole.
    @impl true
    def handle_closed(_input, time, context, {tap, limit, _}) do
      case Situ.Pipeline.Client.call(context.pipeline, :failure) do
        {:ok, %Situ.Error{} = error} -> notify_end(tap, error)
        _ -> notify_end(tap, {:closed, time})
      end

      {[], {tap, limit, :told}}
    end

    @impl true
    def terminate(_reason, {_tap, _limit, :told}), do: :ok

    def terminate(reason, {tap, _limit, :open}) do
      what = "the pipeline of the tap ended: #{inspect(reason, limit: 8)}"
      notify_end(tap, Situ.Error.new(:crashed, what))
    end

    defp notify_end(tap, how) do
      for {pid, _} <- Registry.lookup(Situ.Tap, tap.ref), do: send(pid, {:situ_tap_end, tap, how})
    end

    defp mailbox_room?(pid, limit) when node(pid) == node() do
      case Process.info(pid, :message_queue_len) do
        {:message_queue_len, n} -> n < limit
        nil -> false
      end
    end

    defp mailbox_room?(_remote, _limit), do: true
  end

  @doc false
  def registry_spec, do: {Registry, keys: :duplicate, name: __MODULE__}

  @doc "Adds a tap to `stream`. Returns the stream after the tap, and the tap to subscribe to."
  @spec new(Stream.t(), keyword()) :: {Stream.t(), t()}
  def new(stream, opts \\ [])

  def new(%Stream{} = stream, opts) do
    tap = %__MODULE__{ref: make_ref()}
    {own, placed} = Placement.split_options!(opts, @schema, :operator)
    outlet = {Component, [tap: tap] ++ own}
    {Operator.attach_component(stream, "Tap", outlet, placed, stream.type), tap}
  end

  def new(other, _arg2), do: Argument.raise_invalid!(other, :stream, "Situ.tap(stream)")

  @doc "Subscribes the calling process to the messages from now on."
  @spec subscribe(t()) :: :ok
  def subscribe(%__MODULE__{ref: ref}) do
    unless self() in list_subscribers(ref), do: {:ok, _} = Registry.register(__MODULE__, ref, nil)
    :ok
  end

  @doc "Unsubscribes the calling process."
  @spec unsubscribe(t()) :: :ok
  def unsubscribe(%__MODULE__{ref: ref}), do: Registry.unregister(__MODULE__, ref)

  @doc "Returns whether the tap has any subscribers."
  @spec subscribed?(t()) :: boolean()
  def subscribed?(%__MODULE__{ref: ref}), do: list_subscribers(ref) != []

  defp list_subscribers(ref), do: for({pid, _} <- Registry.lookup(__MODULE__, ref), do: pid)
end
