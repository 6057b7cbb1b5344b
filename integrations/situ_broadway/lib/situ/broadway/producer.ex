defmodule Situ.Broadway.Producer do
  @schema [
    pipeline: [
      type: :any,
      required: true,
      doc: "The pipeline: its label, registered name or process."
    ],
    stream: [type: :string, required: true, doc: "The name of the stream."],
    partition: [
      type: :any,
      default: nil,
      doc:
        "For a stream from `Situ.GenStage.dispatch(stream, {:partition, ...})`: a partition, or `:index` for the " <>
          "number of the producer."
    ],
    acknowledge: [
      type: {:optional, {:fun, 2}},
      default: nil,
      doc:
        "A function that receives the successful and the failed `%Broadway.Message{}` structs of a batch."
    ],
    retry: [type: :pos_integer, default: 1_000, doc: "ms between attempts to find the pipeline."]
  ]

  @moduledoc """
  A Broadway producer of the messages of a pipeline.

      Broadway.start_link(Lobby.Uploads,
        name: Lobby.Uploads,
        producer: [module: {Situ.Broadway.Producer, pipeline: "Lobby", stream: "Visitors"}],
        processors: [default: [concurrency: 4]],
        batchers: [default: [batch_size: 100]]
      )

  A message has the data of Situ's message as `data` and the whole `%Situ.Message{}` as `metadata.situ`.

  The pipeline waits when Broadway does not keep up. To drop messages instead, give the stream an operator with a
  delivery policy that drops. With `concurrency: n`, the producers share the messages if the stream comes from
  `Situ.GenStage.dispatch(stream, :demand)`; otherwise each producer gets all of them.

  The producer waits for a pipeline that is not running, and for the next one of the name when it ends. When Broadway
  is stopped, it handles the messages that the producer has received. Messages of a Broadway that is killed are lost,
  because a pipeline does not deliver twice.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use GenStage
  @behaviour Broadway.Producer
  @behaviour Broadway.Acknowledger

  alias Situ.Broadway.Subscriber

  @impl true
  def init(opts) do
    {broadway, opts} = Keyword.pop(opts, :broadway, [])
    opts = Situ.Options.validate!(opts, @schema)

    {:ok, subscriber} =
      Subscriber.start_link(self(), [subscribe: subscription_options(opts, broadway)] ++ opts)

    {:producer, %{subscriber: subscriber, acknowledger: acknowledger(opts[:acknowledge])}}
  end

  @impl true
  def handle_demand(demand, state) do
    Subscriber.ask(state.subscriber, demand)
    {:noreply, [], state}
  end

  @impl true
  def handle_info({Subscriber, messages}, state), do: {:noreply, wrap(messages, state), state}
  def handle_info(_other, state), do: {:noreply, [], state}

  @impl Broadway.Producer
  def prepare_for_draining(state) do
    :ok = Subscriber.cancel(state.subscriber)
    {:noreply, wrap(flush([]), state), state}
  end

  # The messages that the subscriber has sent before it was cancelled.
  defp flush(received) do
    receive do
      {Subscriber, messages} -> flush(received ++ messages)
    after
      0 -> received
    end
  end

  @impl Broadway.Acknowledger
  def ack(acknowledge, successful, failed) do
    acknowledge.(successful, failed)
    :ok
  end

  defp acknowledger(nil), do: Broadway.NoopAcknowledger.init()
  defp acknowledger(fun), do: {__MODULE__, fun, nil}

  defp wrap(messages, state) do
    for message <- messages,
        do: %Broadway.Message{
          data: message.data,
          metadata: %{situ: message},
          acknowledger: state.acknowledger
        }
  end

  defp subscription_options(opts, broadway) do
    case opts[:partition] do
      nil -> []
      :index -> [partition: broadway[:index]]
      partition -> [partition: partition]
    end
  end
end
