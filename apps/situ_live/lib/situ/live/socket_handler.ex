defmodule Situ.Live.SocketHandler do
  @moduledoc false
  # The handler of a `{:socket, path, Module, arg}` route. Each connection has one process, which
  # calls these callbacks (they have the same form as in the hex package WebSock).
  #
  #     defmodule Echo do
  #       @behaviour Situ.Live.SocketHandler
  #
  #       @impl true
  #       def init(_request, arg), do: {:ok, arg}
  #
  #       @impl true
  #       def handle_in({bytes, opcode: :binary}, state), do: {:push, {:binary, bytes}, state}
  #       def handle_in({text, opcode: :text}, state), do: {:push, {:text, text}, state}
  #
  #       @impl true
  #       def handle_info(message, state), do: {:push, {:text, inspect(message)}, state}
  #     end
  #
  # The server checks host, token and origin before it calls `init/2`. A message larger than the
  # route's `max_frame:` closes the connection (1009), and so does an exception in a callback
  # (1011, logged). A connection that sends nothing for 90 s is closed, so a client should send a
  # message at least every 60 s. A peer that does not read blocks this process, not the sender of
  # its messages: send only requested data, as the studio does with signals and images.

  @type frame :: {:text | :binary, iodata()}
  @type result ::
          {:ok, state :: term()}
          | {:push, frame() | [frame()], state :: term()}
          | {:stop, reason :: term(), state :: term()}

  @callback init(Situ.Live.Request.t(), arg :: term()) :: result() | {:error, String.t()}
  @callback handle_in({binary(), [opcode: :text | :binary]}, state :: term()) :: result()
  @callback handle_info(message :: term(), state :: term()) :: result()
  @callback terminate(reason :: term(), state :: term()) :: term()
  @optional_callbacks handle_info: 2, terminate: 2
end
