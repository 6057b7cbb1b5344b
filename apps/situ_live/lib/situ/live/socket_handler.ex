defmodule Situ.Live.SocketHandler do
  @moduledoc """
  A WebSocket of a `{:socket, path, Module, arg}` route: one process per connection, these callbacks inside it
  (their shapes are those of the hex package WebSock).

      defmodule Echo do
        @behaviour Situ.Live.SocketHandler

        @impl true
        def init(_request, arg), do: {:ok, arg}

        @impl true
        def handle_in({bytes, opcode: :binary}, state), do: {:push, {:binary, bytes}, state}
        def handle_in({text, opcode: :text}, state), do: {:push, {:text, text}, state}

        @impl true
        def handle_info(message, state), do: {:push, {:text, inspect(message)}, state}
      end

  Before `init/2` the server has checked host, token and origin. An incoming message above the route's `max_frame:`
  closes the
  connection (1009), a raise in a callback too (1011, logged). A connection from which nothing came for 90 s is
  closed, so a client
  sends something at least every 60 s. A peer that does not read blocks this process, not the sender of its
  messages: send only what it asked for, as the studio does with signals and pictures.
  """

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
