defmodule Situ.Bridge.PeerSender do
  @moduledoc false
  # The common part of all network sinks: encodes messages by the format, waits for peers if requested, makes the
  # stream wait while no peer has room, and waits at the end for the remaining messages. In a component whose state is
  # an outlet, `use Situ.Bridge.PeerSender` defines the callbacks that handle process messages, the end of the stream
  # and termination. Network sources use `Situ.Bridge.PayloadDecoder`.
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

  # `until` is the deadline for sending the remaining messages; it is set when the pipeline ends.
  defstruct [:opts, :door, :server, :until, waiting: false, holding: false, held: [], lost: 0]
  @type t :: %__MODULE__{}

  defmacro __using__(_opts) do
    quote do
      @impl true
      def handle_info(message, _context, outlet),
        do: Situ.Bridge.PeerSender.handle_stage_message(outlet, message)

      @impl true
      def handle_closed(:in, _time, _context, outlet),
        do: {[], Situ.Bridge.PeerSender.close(outlet)}

      @impl true
      def terminate(_reason, outlet), do: Situ.Bridge.PeerSender.close_now(outlet)
      @impl true
      def describe(outlet), do: Situ.Bridge.PeerSender.describe_peers(outlet)
    end
  end

  @doc "Returns the options that all network sinks have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts), do: %__MODULE__{opts: opts, waiting: opts[:wait_for] > 0}

  @doc "Attaches an open server, given by its module (which implements this behaviour) and its port, if any."
  @spec attach_door(t(), module(), server(), :inet.port_number() | nil) :: t()
  def attach_door(outlet, door, server, port) do
    if outlet.opts[:listening] && port, do: send(outlet.opts[:listening], {:listening, port})
    %{outlet | door: door, server: server}
  end

  @doc "Encodes one message in the format of the options. Raises `Situ.Error` (`:not_writable`)."
  @spec encode_payload(Situ.Message.t(), keyword()) :: iodata()
  def encode_payload(%{data: data} = message, opts) do
    case opts[:format] do
      :raw when is_binary(data) -> data
      :raw -> raise Format.not_writable_error(:raw, data)
      format -> Error.unwrap!(Format.encode(format, data, message.originating_time))
    end
  end

  @doc "Sends the payload, or keeps it and holds the input `in` until there is room."
  @spec send_payload(t(), what :: term()) :: {[tuple()], t()}
  def send_payload(outlet, payload), do: send_held(%{outlet | held: outlet.held ++ [payload]})

  @doc "Handles a message from the stage: a hold has ended, or the pipeline is ending."
  @spec handle_stage_message(t(), term()) :: {[tuple()], t()}
  def handle_stage_message(outlet, {:hold_ended, :in}), do: send_held(outlet)

  def handle_stage_message(%{until: nil} = outlet, {:linger, :end}),
    do: outlet |> extend_deadline() |> send_held()

  def handle_stage_message(outlet, _other), do: {[], outlet}

  defp extend_deadline(outlet), do: %{outlet | until: monotonic_ms() + outlet.opts[:linger]}

  defp send_held(%{waiting: true} = outlet) do
    if outlet.door.ready(outlet.server) >= outlet.opts[:wait_for],
      do: send_held(%{outlet | waiting: false}),
      else: hold_or_give_up(outlet)
  end

  defp send_held(%{held: [], holding: true} = outlet),
    do: {[{:resume, :in}, {:linger, false}], %{outlet | holding: false}}

  defp send_held(%{held: []} = outlet), do: {[], outlet}

  defp send_held(%{held: [payload | rest]} = outlet) do
    case outlet.door.put(outlet.server, payload) do
      :ok ->
        send_held(%{if(outlet.until, do: extend_deadline(outlet), else: outlet) | held: rest})

      :full ->
        hold_or_give_up(outlet)
    end
  end

  # At the end of the pipeline, waiting has a deadline.
  defp hold_or_give_up(%{until: until} = outlet) do
    if until != nil and monotonic_ms() >= until,
      do:
        send_held(%{outlet | waiting: false, held: [], lost: outlet.lost + length(outlet.held)}),
      else: {[{:hold, :in}, {:linger, true}], %{outlet | holding: true}}
  end

  @doc "Closes the outlet at the end of the stream. Raises `Situ.Error` (`:not_delivered`) if messages were lost."
  @spec close(t()) :: t()
  def close(outlet) do
    outlet = outlet |> extend_deadline() |> drain_held()
    lost = outlet.lost + outlet.door.close(outlet.server, outlet.opts[:linger])
    if lost > 0, do: raise(not_delivered(lost, outlet.opts[:linger]))
    %{outlet | server: nil}
  end

  # At the end, the component only has to wait for the held messages, so it may block.
  defp drain_held(outlet) do
    {_, outlet} = send_held(outlet)

    if outlet.held == [] do
      outlet
    else
      receive do
      after
        5 -> drain_held(outlet)
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

  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  @doc "Closes the outlet without waiting."
  @spec close_now(t()) :: :ok
  def close_now(%{server: nil}), do: :ok

  def close_now(outlet) do
    _lost = outlet.door.close(outlet.server, 0)
    :ok
  end

  @doc "Describes the outlet in one line."
  @spec describe_peers(t()) :: String.t()
  def describe_peers(%{server: nil}), do: "closed"

  def describe_peers(%{door: door, server: server}),
    do: "#{door.ready(server)} peers, #{door.dropped(server)} messages dropped"
end
