defmodule Situ.Bridge.Outlet do
  @moduledoc false
  # The common part of all network sinks: encodes messages by the format, waits for peers if requested, makes the
  # stream wait while no peer has room, and lingers at the end. `use Situ.Bridge.Outlet` defines all callbacks except
  # the first ones in a component whose state is an outlet. The counterpart of `Situ.Bridge.Inlet`.
  alias Situ.Bridge.Format
  alias Situ.Error

  @typedoc "The server that holds the connections to the peers; opaque to the outlet."
  @type server :: term()

  @doc "Returns the number of peers that are ready to receive messages."
  @callback ready(server()) :: non_neg_integer()
  @doc "Returns the number of messages dropped for slow peers."
  @callback dropped(server()) :: non_neg_integer()
  @doc "Sends a message to the peers it is for; returns `:full` if the stream must wait."
  @callback put(server(), what :: term()) :: :ok | :full
  @doc """
  Closes the server, after waiting up to `timeout` ms for messages in flight. Returns the number of accepted messages
  that were lost, not counting messages that the protocol may drop at any time.
  """
  @callback close(server(), timeout :: non_neg_integer()) :: lost :: non_neg_integer()

  @options [
    format: [
      type: {:in, [:json, :csv, :message_pack, :situ, :raw]},
      default: :json,
      doc: "A format of `Situ.Bridge.Format`; `:raw`: unchanged bytes."
    ],
    high_water_mark: [
      type: :pos_integer,
      default: 1_000,
      doc: "The maximum number of messages that are queued for one peer."
    ],
    wait_for: [
      type: :non_neg_integer,
      default: 0,
      doc: "The number of peers (subscribers) to wait for before sending anything."
    ],
    linger: [
      type: :non_neg_integer,
      default: 1_000,
      doc:
        "How long to wait at the end until a peer takes the remaining messages, in ms. After that, the error " <>
          "`:not_delivered` reports the number of lost messages."
    ],
    listening: [
      type: {:optional, :pid},
      default: nil,
      doc: "A process that receives `{:listening, port}` once bound; useful with port 0."
    ]
  ]

  # `until`: the deadline for giving up if no message is accepted before; set once the pipeline ends.
  defstruct [:opts, :door, :server, :until, waiting: false, holding: false, held: [], lost: 0]
  @type t :: %__MODULE__{}

  defmacro __using__(_opts) do
    quote do
      @impl true
      def handle_info(message, _context, outlet), do: Situ.Bridge.Outlet.told(outlet, message)
      @impl true
      def handle_closed(:in, _time, _context, outlet), do: {[], Situ.Bridge.Outlet.close(outlet)}
      @impl true
      def terminate(_reason, outlet), do: Situ.Bridge.Outlet.abandon(outlet)
      @impl true
      def describe(outlet), do: Situ.Bridge.Outlet.describe(outlet)
    end
  end

  @doc "Returns the options that all network sinks have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts), do: %__MODULE__{opts: opts, waiting: opts[:wait_for] > 0}

  @doc "Attaches an open server, given with its module (an implementation of this behaviour) and its port, if any."
  @spec open(t(), module(), server(), :inet.port_number() | nil) :: t()
  def open(outlet, door, server, port) do
    if outlet.opts[:listening] && port, do: send(outlet.opts[:listening], {:listening, port})
    %{outlet | door: door, server: server}
  end

  @doc "Encodes one message in the format of the options. Raises `Situ.Error` (`:not_writable`)."
  @spec payload(Situ.Message.t(), keyword()) :: iodata()
  def payload(%{data: data} = message, opts) do
    case opts[:format] do
      :raw when is_binary(data) -> data
      :raw -> raise Format.not_writable(:raw, data)
      format -> Error.unwrap!(Format.encode(format, data, message.originating_time))
    end
  end

  @doc "Sends the payload, or keeps it and holds the input `in` until there is room."
  @spec take(t(), what :: term()) :: {[tuple()], t()}
  def take(outlet, payload), do: pour(%{outlet | held: outlet.held ++ [payload]})

  @doc "Handles a message from the stage: a hold has ended, or the pipeline is ending."
  @spec told(t(), term()) :: {[tuple()], t()}
  def told(outlet, {:hold_ended, :in}), do: pour(outlet)
  def told(%{until: nil} = outlet, {:linger, :end}), do: outlet |> moved() |> pour()
  def told(outlet, _other), do: {[], outlet}

  defp moved(outlet), do: %{outlet | until: now() + outlet.opts[:linger]}

  defp pour(%{waiting: true} = outlet) do
    if outlet.door.ready(outlet.server) >= outlet.opts[:wait_for],
      do: pour(%{outlet | waiting: false}),
      else: wait(outlet)
  end

  defp pour(%{held: [], holding: true} = outlet),
    do: {[{:resume, :in}, {:linger, false}], %{outlet | holding: false}}

  defp pour(%{held: []} = outlet), do: {[], outlet}

  defp pour(%{held: [payload | rest]} = outlet) do
    case outlet.door.put(outlet.server, payload) do
      :ok -> pour(%{if(outlet.until, do: moved(outlet), else: outlet) | held: rest})
      :full -> wait(outlet)
    end
  end

  # At the end of the pipeline, waiting has a deadline.
  defp wait(%{until: until} = outlet) do
    if until != nil and now() >= until,
      do: pour(%{outlet | waiting: false, held: [], lost: outlet.lost + length(outlet.held)}),
      else: {[{:hold, :in}, {:linger, true}], %{outlet | holding: true}}
  end

  @doc "Closes the outlet at the end of the stream. Raises `Situ.Error` (`:not_delivered`) if messages were lost."
  @spec close(t()) :: t()
  def close(outlet) do
    outlet = outlet |> moved() |> drain()
    lost = outlet.lost + outlet.door.close(outlet.server, outlet.opts[:linger])
    if lost > 0, do: raise(not_delivered(lost, outlet.opts[:linger]))
    %{outlet | server: nil}
  end

  # At the end, the component only has to wait for the held messages, so it may block.
  defp drain(outlet) do
    {_, outlet} = pour(outlet)

    if outlet.held == [] do
      outlet
    else
      receive do
      after
        5 -> drain(outlet)
      end
    end
  end

  defp not_delivered(lost, linger) do
    what = if lost == 1, do: "a message was", else: "#{lost} messages were"

    Error.new(:not_delivered, what <> " not delivered",
      why: "no peer took them within #{linger} ms after the end",
      fix: "check the receiving side, or wait longer at the end (`linger:`)"
    )
  end

  defp now, do: System.monotonic_time(:millisecond)

  @doc "Closes the outlet without waiting."
  @spec abandon(t()) :: :ok
  def abandon(%{server: nil}), do: :ok

  def abandon(outlet) do
    _lost = outlet.door.close(outlet.server, 0)
    :ok
  end

  @doc "Describes the outlet in one line."
  @spec describe(t()) :: String.t()
  def describe(%{server: nil}), do: "closed"

  def describe(%{door: door, server: server}),
    do: "#{door.ready(server)} peers, #{door.dropped(server)} messages dropped"
end
