defmodule Situ.Bridge.Net.SendQueue do
  @moduledoc false
  # Counts the messages that wait for the process of one connection, so that a slow connection neither blocks the sender
  # nor fills memory. The sender calls `put/4`; the connection receives `{:send, bytes}` and calls `flush/3`.

  @type t :: :atomics.atomics_ref()

  @send_timeout 30_000
  @max_batch 500

  @spec new() :: t()
  def new, do: :atomics.new(1, [])

  @doc "Returns the socket options of a connection."
  def socket_options,
    do:
      [nodelay: true, send_timeout: @send_timeout, send_timeout_close: true] ++
        Situ.TcpKeepalive.options()

  @spec put(t(), pid(), iodata(), max :: pos_integer()) :: :ok | :full
  def put(outbox, connection, bytes, max) do
    if :atomics.get(outbox, 1) < max do
      :atomics.add(outbox, 1, 1)
      send(connection, {:send, bytes})
      :ok
    else
      :full
    end
  end

  @doc "Returns the number of waiting messages."
  @spec count_waiting(t()) :: non_neg_integer()
  def count_waiting(outbox), do: :atomics.get(outbox, 1)

  @doc "Sends `bytes` and all other waiting messages in one system call."
  @spec flush(t(), :gen_tcp.socket(), iodata()) :: :ok | {:error, term()}
  def flush(outbox, tcp, bytes) do
    {count, batch} = gather_messages(1, [bytes])

    with :ok <- :gen_tcp.send(tcp, Enum.reverse(batch)), do: :atomics.sub(outbox, 1, count)
  end

  defp gather_messages(count, batch) when count >= @max_batch, do: {count, batch}

  defp gather_messages(count, batch) do
    receive do
      {:send, bytes} -> gather_messages(count + 1, [bytes | batch])
    after
      0 -> {count, batch}
    end
  end
end
