defmodule Situ.Tap do
  @moduledoc """
  A place in a running pipeline where any process may listen.

      {level, tap} = Situ.Tap.new(level)
      ...
      :ok = Situ.Tap.subscribe(tap)
      receive do
        {:situ_tap, ^tap, message} -> IO.inspect(message.data)
      end

  A subscriber gets `{:situ_tap, tap, message}` for each message from then on and `{:situ_tap_end, tap, how}` when
  there will be no more: `how` is `{:closed, time}`, or the `Situ.Error` that ended the pipeline. It gets nothing once
  it has unsubscribed or ended. A listener does not slow the pipeline down: when more than `max_queue:` messages
  (default 10,000) wait in its mailbox, it misses messages.
  """

  alias Situ.{Argument, Operator, Stream}
  alias Situ.Graph.Placement

  @schema [max_queue: [type: :pos_integer, default: 10_000, doc: "See above."]]

  @enforce_keys [:ref]
  defstruct [:ref]

  @type t :: %__MODULE__{ref: reference()}

  defmodule Outlet do
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
      for {pid, _} <- Registry.lookup(Situ.Tap, tap.ref), room?(pid, limit) do
        send(pid, {:situ_tap, tap, message})
      end

      {[{:out, message.originating_time, message.data}], state}
    end

    # Why it ends is for the pipeline to say: it fails as a whole.
    @impl true
    def handle_closed(_input, time, context, {tap, limit, _}) do
      case Situ.Pipeline.Client.call(context.pipeline, :failure) do
        {:ok, %Situ.Error{} = error} -> tell(tap, error)
        _ -> tell(tap, {:closed, time})
      end

      {[], {tap, limit, :told}}
    end

    @impl true
    def terminate(_reason, {_tap, _limit, :told}), do: :ok

    def terminate(reason, {tap, _limit, :open}) do
      what = "the pipeline of the tap ended: #{inspect(reason, limit: 8)}"
      tell(tap, Situ.Error.new(:crashed, what))
    end

    defp tell(tap, how) do
      for {pid, _} <- Registry.lookup(Situ.Tap, tap.ref), do: send(pid, {:situ_tap_end, tap, how})
    end

    defp room?(pid, limit) when node(pid) == node() do
      case Process.info(pid, :message_queue_len) do
        {:message_queue_len, n} -> n < limit
        nil -> false
      end
    end

    defp room?(_remote, _limit), do: true
  end

  @doc false
  def registry, do: {Registry, keys: :duplicate, name: __MODULE__}

  @doc "A tap behind `stream`: the stream that goes on, and the tap to subscribe to."
  @spec new(Stream.t(), keyword()) :: {Stream.t(), t()}
  def new(stream, opts \\ [])

  def new(%Stream{} = stream, opts) do
    tap = %__MODULE__{ref: make_ref()}
    {own, placed} = Placement.split!(opts, @schema, :operator)
    outlet = {Outlet, [tap: tap] ++ own}
    {Operator.through(stream, "Tap", outlet, placed, stream.type), tap}
  end

  def new(other, _arg2), do: Argument.refuse!(other, :stream, "Situ.tap(stream)")

  @doc "The calling process gets messages from now on."
  @spec subscribe(t()) :: :ok
  def subscribe(%__MODULE__{ref: ref}) do
    unless self() in subscribers(ref), do: {:ok, _} = Registry.register(__MODULE__, ref, nil)
    :ok
  end

  @doc "The calling process gets no more messages."
  @spec unsubscribe(t()) :: :ok
  def unsubscribe(%__MODULE__{ref: ref}), do: Registry.unregister(__MODULE__, ref)

  @doc "Whether anyone listens."
  @spec subscribed?(t()) :: boolean()
  def subscribed?(%__MODULE__{ref: ref}), do: subscribers(ref) != []

  defp subscribers(ref), do: for({pid, _} <- Registry.lookup(__MODULE__, ref), do: pid)
end
