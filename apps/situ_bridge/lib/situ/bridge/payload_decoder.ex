defmodule Situ.Bridge.PayloadDecoder do
  @moduledoc false
  # The common part of all network sources: decodes payloads, assigns a time to each message, and keeps the times of
  # the stream increasing. Payloads from outside never stop a pipeline: unusable payloads are dropped and counted.
  # Pure.
  alias Situ.Bridge.Format

  @options [
    format: [
      type: {:in, [:json, :csv, :message_pack, :situ, :raw]},
      default: :json,
      doc: "The format of messages (`Situ.Bridge.Format`); `:raw`: unchanged bytes."
    ],
    times: [
      type: {:in, [:sender, :arrival]},
      default: :sender,
      doc: "Originating times: the sender's times, or the times of arrival (always with `:raw`)."
    ],
    objects: [
      type: {:in, [:maps, :pairs]},
      default: :maps,
      doc: "Whether objects are read as maps or as ordered pairs; see `Situ.Bridge.Format`."
    ],
    type: [type: :any, default: :any, doc: "The type of the stream."]
  ]

  defstruct [:format, :times, :opts, :last, emitted: 0, unreadable: 0, late: 0]
  @type t :: %__MODULE__{}
  @typedoc """
  Bytes, or bytes with the sender's time outside of them (if any) and a function that completes the decoded value.
  """
  @type payload :: binary() | {binary(), Situ.Time.t() | nil, (term() -> term())}

  @doc "Returns the options that all network sources have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts),
    do: %__MODULE__{format: opts[:format], times: opts[:times], opts: [objects: opts[:objects]]}

  @doc "Decodes payloads into messages `{:out, time, value}`. The decoder counts the payloads that it drops."
  @spec take_payloads(t(), [payload()], now :: Situ.Time.t()) :: {[tuple()], t()}
  def take_payloads(decoder, payloads, now),
    do: take_decoded(decoder, Enum.map(payloads, &decode_payload(decoder, &1, now)))

  @doc "Same as `take_payloads/3` for decoded messages: `{:ok, {time, sender's?, value}}`, or `{:error, error}`."
  @spec take_decoded(t(), [{:ok, {Situ.Time.t(), boolean(), term()}} | {:error, term()}]) ::
          {[tuple()], t()}
  def take_decoded(decoder, results) do
    {actions, decoder} = Enum.reduce(results, {[], decoder}, &take_message/2)
    {Enum.reverse(actions), decoder}
  end

  defp take_message({:ok, {time, sender_time?, value}}, {actions, decoder}),
    do: accept_message(time, sender_time?, value, actions, decoder)

  defp take_message({:error, _error}, {actions, decoder}),
    do: {actions, %{decoder | unreadable: decoder.unreadable + 1}}

  defp decode_payload(decoder, {bytes, time, complete}, now) do
    with {:ok, {own_time, own?, value}} <- decode_payload(decoder, bytes, now) do
      if time != nil and decoder.times == :sender and not own?,
        do: {:ok, {time, true, complete.(value)}},
        else: {:ok, {own_time, own?, complete.(value)}}
    end
  end

  defp decode_payload(%{format: :raw}, payload, now), do: {:ok, {now, false, payload}}

  defp decode_payload(decoder, payload, now) do
    with {:ok, {time, value}} <- Format.decode(decoder.format, payload, decoder.opts) do
      if decoder.times == :arrival,
        do: {:ok, {now, false, value}},
        else: {:ok, {time, true, value}}
    end
  end

  # Several messages may arrive at the same clock reading, so arrival times are shifted. The sender's times are not
  # changed.
  defp accept_message(time, sender_time?, value, actions, decoder) do
    cond do
      decoder.last == nil or time > decoder.last -> emit_message(time, value, actions, decoder)
      sender_time? -> {actions, %{decoder | late: decoder.late + 1}}
      true -> emit_message(decoder.last + 1, value, actions, decoder)
    end
  end

  defp emit_message(time, value, actions, decoder),
    do: {[{:out, time, value} | actions], %{decoder | last: time, emitted: decoder.emitted + 1}}

  @doc "Describes the decoder in one line."
  @spec describe_counts(t()) :: String.t()
  def describe_counts(decoder),
    do:
      "#{decoder.emitted} messages, #{decoder.unreadable} unreadable, " <>
        "#{decoder.late} not later than the previous message"
end
