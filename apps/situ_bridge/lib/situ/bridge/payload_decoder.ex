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

  defstruct [:format, :times, :opts, :last, :trouble, taken: 0, unreadable: 0, late: 0]
  @type t :: %__MODULE__{}

  @doc "Returns the options that all network sources have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts),
    do: %__MODULE__{format: opts[:format], times: opts[:times], opts: [objects: opts[:objects]]}

  @doc "Decodes payloads into messages `{:out, time, value}`; the inlet keeps the error of the last dropped payload."
  @spec take_payloads(t(), [binary()], now :: Situ.Time.t()) :: {[tuple()], t()}
  def take_payloads(inlet, payloads, now),
    do: take_decoded(inlet, Enum.map(payloads, &decode_payload(inlet, &1, now)))

  @doc "Same as `take_payloads/3` for decoded messages: `{:ok, {time, sender's?, value}}`, or `{:error, error}`."
  @spec take_decoded(t(), [{:ok, {Situ.Time.t(), boolean(), term()}} | {:error, term()}]) ::
          {[tuple()], t()}
  def take_decoded(inlet, read) do
    {found, inlet} = Enum.reduce(read, {[], inlet}, &take_message/2)
    {Enum.reverse(found), inlet}
  end

  defp take_message({:ok, {time, own?, value}}, {found, inlet}),
    do: accept_message(time, own?, value, found, inlet)

  defp take_message({:error, error}, {found, inlet}),
    do: {found, %{inlet | unreadable: inlet.unreadable + 1, trouble: error}}

  defp decode_payload(%{format: :raw}, payload, now), do: {:ok, {now, false, payload}}

  defp decode_payload(inlet, payload, now) do
    with {:ok, {time, value}} <- Format.decode(inlet.format, payload, inlet.opts) do
      if inlet.times == :arrival, do: {:ok, {now, false, value}}, else: {:ok, {time, true, value}}
    end
  end

  # Several messages may arrive at the same clock reading, so arrival times are shifted. The sender's times are not
  # changed.
  defp accept_message(time, own?, value, found, inlet) do
    cond do
      inlet.last == nil or time > inlet.last -> emit_message(time, value, found, inlet)
      own? -> {found, %{inlet | late: inlet.late + 1}}
      true -> emit_message(inlet.last + 1, value, found, inlet)
    end
  end

  defp emit_message(time, value, found, inlet),
    do: {[{:out, time, value} | found], %{inlet | last: time, taken: inlet.taken + 1}}

  @doc "Describes the inlet in one line."
  @spec describe_counts(t()) :: String.t()
  def describe_counts(inlet),
    do:
      "#{inlet.taken} messages, #{inlet.unreadable} unreadable, #{inlet.late} not later than the previous message"
end
