defmodule Situ.Studio.Web.DataHandler do
  @moduledoc false
  # Handles the data socket: passes requests to the session and replies back. The server sends exactly one reply per
  # request and nothing else, so at most one reply waits for a page that has stopped reading. See
  # docs/adr/0080-the-page-pulls-its-data.md.
  @behaviour Situ.Live.SocketHandler

  alias Situ.Studio.{Catalog, Comparison, DataSession}

  @impl true
  def init(request, studio) do
    case Comparison.open_item(studio, request.query["source"], request.query) do
      {:ok, _item, source, _compared} ->
        {:ok, DataSession.new(source, Catalog.settings(studio).visualizers)}

      {:error, error} ->
        {:error, error.what}
    end
  end

  @impl true
  def handle_in({text, opcode: :text}, session) do
    case DataSession.handle_request(text, session) do
      {:ok, reply, session} -> {:push, {:binary, reply}, session}
      {:error, error} -> {:stop, {:shutdown, error.code}, session}
    end
  end

  def handle_in(_, session), do: {:stop, {:shutdown, :bad_request}, session}
end
