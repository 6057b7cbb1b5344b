defmodule Situ.Studio.Web.Derivation do
  @moduledoc false
  # The derived streams of a page: those of its layout, and those made on it.
  import Situ.Live.Socket, only: [assign: 2]

  alias Situ.Error
  alias Situ.Live.Socket
  alias Situ.Studio.Source.Derived
  alias Situ.Studio.StreamInfo

  @most 64

  @doc "Facts about the derived streams; one whose input streams the recording lacks is left out."
  @spec infos(map()) :: [StreamInfo.t()]
  def infos(assigns) do
    for "= " <> text <- names(assigns),
        {:ok, info} <- [Derived.derive(assigns.source, text)],
        do: info
  end

  defp names(assigns) do
    shown = for panel <- rows(assigns[:layout]), vis <- panel.vis, do: vis.stream
    (assigns.derived ++ shown) |> Enum.filter(&Derived.name?/1) |> Enum.uniq() |> Enum.take(@most)
  end

  defp rows(nil), do: []
  defp rows(layout), do: layout.rows

  @doc "Loads the streams again when the layout has derived ones that are not known yet."
  @spec known(Socket.t(), (Socket.t() -> Socket.t())) :: Socket.t()
  def known(%{assigns: %{shapes: shapes} = assigns} = socket, load) do
    if Enum.all?(names(assigns), &is_map_key(shapes, &1)), do: socket, else: load.(socket)
  end

  def known(socket, _load), do: socket

  @doc "The name of the stream that an expression makes, known to the page from now on."
  @spec add(Socket.t(), String.t()) :: {:ok, String.t(), Socket.t()} | {:error, Error.t()}
  def add(%{assigns: assigns} = socket, text) do
    with {:ok, info} <- Derived.derive(assigns.source, String.slice(text, 0, 1_000)) do
      derived = Enum.take(Enum.uniq([info.name | assigns.derived]), @most)
      {:ok, info.name, assign(socket, derived: derived)}
    end
  end
end
