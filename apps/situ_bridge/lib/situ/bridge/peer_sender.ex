defmodule Situ.Bridge.PeerSender do
  @moduledoc false
  # The common part of all network sinks: encodes messages by the format, waits for peers if requested, makes the
  # stream wait while no peer has room, and waits at the end for the remaining messages. In a component whose state is
  # a sink, `use Situ.Bridge.PeerSender` defines the callbacks that handle process messages, the end of the stream
  # and termination. Network sources use `Situ.Bridge.PayloadDecoder`.
  alias Situ.Bridge.Format
  alias Situ.Error

  @typedoc "The server that holds the connections to the peers; opaque to the sink."
  @type server :: term()

  @doc "Returns the number of peers that are ready to receive messages."
  @callback count_ready(server()) :: non_neg_integer()
  @doc "Returns the number of messages dropped for slow peers."
  @callback count_dropped(server()) :: non_neg_integer()
  @doc "Sends a message to the peers it is for; returns `:full` if the stream must wait."
  @callback put(server(), payload :: term()) :: :ok | :full
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

  # `deadline` is the time limit for sending the remaining messages; it is set when the pipeline ends.
  defstruct [
    :opts,
    :module,
    :server,
    :deadline,
    waiting?: false,
    holding?: false,
    payloads: [],
    lost: 0
  ]

  @type t :: %__MODULE__{}

  defmacro __using__(_opts) do
    quote do
      @impl true
      def handle_info(message, _context, sender),
        do: Situ.Bridge.PeerSender.handle_stage_message(sender, message)

      @impl true
      def handle_closed(:in, _time, _context, sender),
        do: {[], Situ.Bridge.PeerSender.close(sender)}

      @impl true
      def terminate(_reason, sender), do: Situ.Bridge.PeerSender.close_now(sender)
      @impl true
      def describe(sender), do: Situ.Bridge.PeerSender.describe_peers(sender)
    end
  end

  @doc "Returns the options that all network sinks have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts), do: %__MODULE__{opts: opts, waiting?: opts[:wait_for] > 0}

  @doc "Attaches an open server, given by its module (which implements this behaviour) and its port, if any."
  @spec attach_server(t(), module(), server(), :inet.port_number() | nil) :: t()
  def attach_server(sender, module, server, port) do
    if sender.opts[:listening] && port, do: send(sender.opts[:listening], {:listening, port})
    %{sender | module: module, server: server}
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
  @spec send_payload(t(), payload :: term()) :: {[tuple()], t()}
  def send_payload(sender, payload),
    do: send_payloads(%{sender | payloads: sender.payloads ++ [payload]})

  @doc "Handles a message from the stage: a hold has ended, or the pipeline is ending."
  @spec handle_stage_message(t(), term()) :: {[tuple()], t()}
  def handle_stage_message(sender, {:hold_ended, :in}), do: send_payloads(sender)

  def handle_stage_message(%{deadline: nil} = sender, {:linger, :end}),
    do: sender |> extend_deadline() |> send_payloads()

  def handle_stage_message(sender, _other), do: {[], sender}

  defp extend_deadline(sender), do: %{sender | deadline: monotonic_ms() + sender.opts[:linger]}

  defp send_payloads(%{waiting?: true} = sender) do
    if sender.module.count_ready(sender.server) >= sender.opts[:wait_for],
      do: send_payloads(%{sender | waiting?: false}),
      else: hold_or_give_up(sender)
  end

  defp send_payloads(%{payloads: [], holding?: true} = sender),
    do: {[{:resume, :in}, {:linger, false}], %{sender | holding?: false}}

  defp send_payloads(%{payloads: []} = sender), do: {[], sender}

  defp send_payloads(%{payloads: [payload | rest]} = sender) do
    case sender.module.put(sender.server, payload) do
      :ok ->
        send_payloads(%{
          if(sender.deadline, do: extend_deadline(sender), else: sender)
          | payloads: rest
        })

      :full ->
        hold_or_give_up(sender)
    end
  end

  # At the end of the pipeline, waiting has a deadline.
  defp hold_or_give_up(%{deadline: deadline} = sender) do
    if deadline != nil and monotonic_ms() >= deadline,
      do:
        send_payloads(%{
          sender
          | waiting?: false,
            payloads: [],
            lost: sender.lost + length(sender.payloads)
        }),
      else: {[{:hold, :in}, {:linger, true}], %{sender | holding?: true}}
  end

  @doc "Closes the sink at the end of the stream. Raises `Situ.Error` (`:not_delivered`) if messages were lost."
  @spec close(t()) :: t()
  def close(sender) do
    sender = sender |> extend_deadline() |> drain_payloads()
    lost = sender.lost + sender.module.close(sender.server, sender.opts[:linger])
    if lost > 0, do: raise(not_delivered(lost, sender.opts[:linger]))
    %{sender | server: nil}
  end

  # At the end, the component only has to wait for the held messages, so it may block.
  defp drain_payloads(sender) do
    {_, sender} = send_payloads(sender)

    if sender.payloads == [] do
      sender
    else
      receive do
      after
        5 -> drain_payloads(sender)
      end
    end
  end

  defp not_delivered(lost, linger) do
    subject = if lost == 1, do: "a message was", else: "#{lost} messages were"

    Error.new(:not_delivered, subject <> " not delivered",
      why: "no peer took them within #{linger} ms after the end",
      fix: "check the receiving side, or wait longer at the end (`linger:`)"
    )
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  @doc "Closes the sink without waiting."
  @spec close_now(t()) :: :ok
  def close_now(%{server: nil}), do: :ok

  def close_now(sender) do
    _lost = sender.module.close(sender.server, 0)
    :ok
  end

  @doc "Describes the sink in one line."
  @spec describe_peers(t()) :: String.t()
  def describe_peers(%{server: nil}), do: "closed"

  def describe_peers(%{module: module, server: server}),
    do: "#{module.count_ready(server)} peers, #{module.count_dropped(server)} messages dropped"
end
