defmodule Situ.Python.Workers do
  @moduledoc false
  # Several workers for one stream: a splitter gives them the messages in turn, and a merger emits their results in the
  # order of the messages. Each worker emits exactly one message for each of its messages, which contains the results,
  # so the merger knows whose turn it is.
  # See docs/adr/0179-several-workers-take-messages-in-turn.md.
  alias Situ.Python.{SingleComponent, Workers}
  alias Situ.{Delivery, Stream}

  # Few messages wait for each worker, so that lossy policies before the splitter deliver recent messages.
  @waiting 2

  @type settings :: %{
          count: pos_integer(),
          own: keyword(),
          placement: keyword(),
          outputs: keyword()
        }

  @doc "Adds the workers for `stream`, the input `input`."
  @spec add_workers(Stream.t(), atom(), settings()) :: Stream.t() | %{atom() => Stream.t()}
  def add_workers(stream, input, settings) do
    {name, placement} = Keyword.pop(settings.placement, :name, settings.placement[:default_name])
    {policy, placement} = Keyword.pop(placement, :policy)

    Situ.composite(stream, name, fn stream ->
      split = split(stream, settings.count, if(policy, do: [policy: policy], else: []))

      workers =
        for {name, messages} <- split do
          ports = [inputs: [{input, stream.type}], outputs: [results: :any]]
          opts = settings.own ++ ports ++ placement ++ [policy: Delivery.throttle(@waiting)]
          {name, Situ.via([{input, messages}], SingleComponent, opts)}
        end

      Situ.via(workers, Workers.Merger,
        name: "Merger",
        workers: Keyword.keys(workers),
        inputs: for({name, _} <- workers, do: {name, :any}),
        outputs: settings.outputs
      )
    end)
  end

  defp split(stream, count, opts) do
    names = for i <- 1..count, do: String.to_atom("worker_#{i}")
    ports = [inputs: [in: stream.type], outputs: for(name <- names, do: {name, stream.type})]

    streams =
      Situ.via(
        stream,
        Workers.Splitter,
        [name: "Splitter", outputs_in_turn: names] ++ ports ++ opts
      )

    for name <- names, do: {name, streams[name]}
  end
end
