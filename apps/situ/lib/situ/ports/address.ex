defmodule Situ.Ports.Address do
  @moduledoc false
  # Where a neighbour of a stage receives messages: its process, or another stage of the same process (see
  # Situ.Stage.SharedProcess). The messages between stages of one process wait in its dictionary, so that they are not
  # copied. Both kinds have the form of GenStage's messages.

  @compile {:inline, send_to_consumer: 3, send_to_producer: 3}

  @key :situ_local_messages

  @typedoc """
  A process, a consumer in the same process, a producer in the same process with its consumer, or the process that
  forwards what a stage sends to its producer (see Situ.Stage.Relocation).
  """
  @type t ::
          pid()
          | {:local, consumer :: pos_integer()}
          | {:local, producer :: pos_integer(), consumer :: pos_integer()}
          | {:relay, pid()}

  @doc "Sends batches, or the end of the subscription `tag`, to a consumer."
  @spec send_to_consumer(t(), term(), term()) :: term()
  def send_to_consumer(pid, tag, entry) when is_pid(pid),
    do: send(pid, {:"$gen_consumer", {self(), tag}, entry})

  def send_to_consumer({:local, id}, tag, entry),
    do: push_local(id, {:"$gen_consumer", {self(), tag}, entry})

  @doc "Sends demand, or the end of the subscription `tag`, to a producer."
  @spec send_to_producer(t(), term(), term()) :: term()
  def send_to_producer(pid, tag, request) when is_pid(pid),
    do: send(pid, {:"$gen_producer", {self(), tag}, request})

  def send_to_producer({:local, id, consumer}, tag, request),
    do: push_local(id, {:"$gen_producer", {{:local, consumer}, tag}, request})

  def send_to_producer({:relay, pid}, tag, request), do: send(pid, {:situ_relay, tag, request})

  @doc "Asks a producer for all the messages that it holds for a consumer with a lossy policy."
  @spec request_refresh(pid() | {:relay, pid()}, term()) :: term()
  def request_refresh(pid, tag) when is_pid(pid),
    do: send(pid, {:situ, {:refresh, {self(), tag}}})

  def request_refresh({:relay, pid}, tag), do: send(pid, {:situ_relay, tag, :refresh})

  @doc "Acknowledges the end of the subscription `tag` to a producer: the consumer needs nothing again."
  @spec acknowledge_end(t(), term()) :: term()
  def acknowledge_end(pid, tag) when is_pid(pid), do: send(pid, {:situ, {:untap, tag}})

  def acknowledge_end({:local, id, _consumer}, tag), do: push_local(id, {:situ, {:untap, tag}})
  def acknowledge_end({:relay, pid}, tag), do: send(pid, {:situ_relay, tag, :acknowledge_end})

  @doc "Forwards a request of a stage that has left this process to the producer `pid`."
  @spec relay_request(pid(), term(), term()) :: term()
  def relay_request(pid, tag, :refresh), do: request_refresh(pid, tag)
  def relay_request(pid, tag, :acknowledge_end), do: acknowledge_end(pid, tag)
  def relay_request(pid, tag, request), do: send_to_producer(pid, tag, request)

  @doc "Adds a message for a stage of the calling process."
  @spec push_local(pos_integer(), term()) :: term()
  def push_local(id, message),
    do: Process.put(@key, [{id, message} | Process.get(@key, [])])

  @doc "Takes the messages for stages of the calling process, with the stages' ids, oldest first."
  @spec take_local() :: [{pos_integer(), term()}]
  def take_local do
    case Process.put(@key, []) do
      nil -> []
      messages -> :lists.reverse(messages)
    end
  end
end
