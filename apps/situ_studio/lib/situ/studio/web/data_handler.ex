defmodule Situ.Studio.Web.DataHandler do
  @moduledoc false
  # The data socket: carries requests to the session and answers back. One answer to each request, nothing unasked, so a
  # page that stops reading stops asking, and at most one answer waits for it.
  @behaviour Situ.Live.SocketHandler

  alias Situ.Studio.{Catalog, Comparison, DataSession}

  @impl true
  def init(request, studio) do
    case Comparison.open(studio, request.query["source"], request.query) do
      {:ok, _item, source, _compared} ->
        {:ok, DataSession.new(source, Catalog.settings(studio).visualizers)}

      {:error, error} ->
        {:error, error.what}
    end
  end

  @impl true
  def handle_in({text, opcode: :text}, session) do
    case DataSession.handle(text, session) do
      {:ok, reply, session} -> {:push, {:binary, reply}, session}
      {:error, error} -> {:stop, {:shutdown, error.code}, session}
    end
  end

  def handle_in(_, session), do: {:stop, {:shutdown, :bad_request}, session}
end
