defmodule Situ.Bridge.Outlet do
  @moduledoc false
  # The common part of all network sinks: it encodes messages by the format, waits for peers if asked to, makes the
  # stream wait while no peer has room, and lingers at the end. The counterpart of `Situ.Bridge.Inlet`.
  alias Situ.Bridge.Format
  alias Situ.Error

  @typedoc "Who has the peers, as the door knows it."
  @type server :: term()

  @doc "How many peers want to have messages."
  @callback ready(server()) :: non_neg_integer()
  @doc "How many messages were dropped for peers that are too slow."
  @callback dropped(server()) :: non_neg_integer()
  @doc "Sends to whom it concerns; `:full` when the stream is to wait."
  @callback put(server(), what :: term()) :: :ok | :full
  @doc "Closes after at most so many ms of waiting for messages under way."
  @callback close(server(), timeout :: non_neg_integer()) :: :ok

  @options [
    format: [
      type: {:in, [:json, :csv, :message_pack, :situ, :raw]},
      default: :json,
      doc: "A format of `Situ.Bridge.Format`; `:raw`: data that are bytes, as they are."
    ],
    high_water_mark: [
      type: :pos_integer,
      default: 1_000,
      doc: "The most messages that wait for one peer."
    ],
    wait_for: [
      type: :non_neg_integer,
      default: 0,
      doc: "Send nothing before so many peers (subscribers) are there."
    ],
    linger: [
      type: :non_neg_integer,
      default: 1_000,
      doc: "How long to wait at the end for what is still to be sent, ms."
    ],
    listening: [
      type: {:optional, :pid},
      default: nil,
      doc: "Gets `{:listening, port}` once bound; of use with port 0."
    ]
  ]

  defstruct [:opts, :door, :server, waiting: false, held: []]
  @type t :: %__MODULE__{}

  @doc "The options that all such sinks have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts), do: %__MODULE__{opts: opts, waiting: opts[:wait_for] > 0}

  @doc "Goes through a door that is open, a module of this behaviour and its process; `port` is the one it got, if any."
  @spec open(t(), module(), server(), :inet.port_number() | nil) :: t()
  def open(outlet, door, server, port) do
    if outlet.opts[:listening] && port, do: send(outlet.opts[:listening], {:listening, port})
    %{outlet | door: door, server: server}
  end

  @doc "One message by the format of the options. Raises `Situ.Error` (`:not_writable`)."
  @spec payload(Situ.Message.t(), keyword()) :: iodata()
  def payload(%{data: data} = message, opts) do
    case opts[:format] do
      :raw when is_binary(data) -> data
      :raw -> raise Format.not_writable(:raw, data)
      format -> Error.unwrap!(Format.encode(format, data, message.originating_time))
    end
  end

  @doc "Sends what goes through the door, or keeps it and holds the input `in` until there is room."
  @spec take(t(), what :: term()) :: {[tuple()], t()}
  def take(outlet, payload), do: pour(%{outlet | held: outlet.held ++ [payload]})

  @doc "Tries once more, when a hold has ended."
  @spec pour(t()) :: {[tuple()], t()}
  def pour(%{waiting: true} = outlet) do
    if outlet.door.ready(outlet.server) >= outlet.opts[:wait_for],
      do: pour(%{outlet | waiting: false}),
      else: {[{:hold, :in}], outlet}
  end

  def pour(%{held: []} = outlet), do: {[{:resume, :in}], outlet}

  def pour(%{held: [payload | rest]} = outlet) do
    case outlet.door.put(outlet.server, payload) do
      :ok -> pour(%{outlet | held: rest})
      :full -> {[{:hold, :in}], outlet}
    end
  end

  @doc "The end of the stream: there is nothing else to do than to wait for what is held."
  @spec close(t()) :: t()
  def close(outlet) do
    outlet = drain(outlet, System.monotonic_time(:millisecond) + outlet.opts[:linger])
    outlet.door.close(outlet.server, outlet.opts[:linger])
    %{outlet | server: nil}
  end

  defp drain(outlet, until) do
    {_, outlet} = pour(outlet)

    if outlet.held != [] and System.monotonic_time(:millisecond) < until do
      receive do
      after
        5 -> drain(outlet, until)
      end
    else
      outlet
    end
  end

  @doc "Closes without waiting."
  @spec abandon(t()) :: :ok
  def abandon(%{server: nil}), do: :ok
  def abandon(outlet), do: outlet.door.close(outlet.server, 0)

  @doc "One line for people."
  @spec describe(t()) :: String.t()
  def describe(%{server: nil}), do: "closed"

  def describe(%{door: door, server: server}),
    do: "#{door.ready(server)} peers, #{door.dropped(server)} messages dropped"
end
