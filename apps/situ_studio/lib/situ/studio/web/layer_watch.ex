defmodule Situ.Studio.Web.LayerWatch do
  @moduledoc false
  # Keeps a page up to date with the annotation layers of its item: layers that other pages create or edit, and
  # versions that other programs save.
  import Situ.Live.Socket, only: [assign: 2, connected?: 1, push_event: 3]

  alias Situ.Annotation.Editor
  alias Situ.Live.Socket
  alias Situ.Studio.Annotations.{Editors, Home}
  alias Situ.Studio.Web.{LayoutMenu, StreamFacts}

  @registry Situ.Studio.Peers

  @doc "Subscribes the page to the layers of its item."
  @spec join(Socket.t()) :: Socket.t()
  def join(%{assigns: %{item: %{layers: home}, studio: studio}} = socket) when home != nil do
    if connected?(socket) do
      {:ok, _} = Registry.register(@registry, {studio, :layers, home}, nil)
      subscribe_all(studio, home)
    end

    assign(socket, layer_versions: Home.list_versions(home))
  end

  def join(socket), do: assign(socket, layer_versions: [])

  # An editor that ends in the meantime is not a reason for the page to fail.
  defp subscribe_all(studio, home) do
    for editor <-
          Editors.list_editors(studio, Enum.map(Home.list_versions(home), &elem(&1, 0))),
        do: Editor.subscribe(editor)
  catch
    :exit, _ -> []
  end

  @doc "Notifies all pages that show the item, including this one, that its layers have changed."
  @spec announce(Socket.t()) :: Socket.t()
  def announce(%{assigns: %{item: %{layers: home}, studio: studio}} = socket) do
    Registry.dispatch(@registry, {studio, :layers, home}, fn pages ->
      for {pid, _} <- pages, do: send(pid, :layers_changed)
    end)

    socket
  end

  @doc "Reads the layers again. The automatic layout then shows new layers."
  @spec refresh(Socket.t()) :: Socket.t()
  def refresh(%{assigns: %{item: %{layers: home}, studio: studio}} = socket) when home != nil do
    subscribe_all(studio, home)

    socket
    |> assign(layer_versions: Home.list_versions(home))
    |> StreamFacts.load()
    |> LayoutMenu.rebuild_automatic()
    |> push_event("layers_changed", %{})
  end

  def refresh(socket), do: socket

  @doc "Requests the page's streams of layers again after an edit. `change` is the editor's message."
  @spec show_edit(Socket.t(), term()) :: Socket.t()
  def show_edit(%{assigns: %{item: %{layers: home}}} = socket, :saved),
    do: assign(socket, layer_versions: Home.list_versions(home))

  def show_edit(socket, _change), do: push_event(socket, "layers_changed", %{})

  @doc "Reads the layers again if another program has saved a layer."
  @spec check_saved(Socket.t()) :: Socket.t()
  def check_saved(%{assigns: %{item: %{layers: home}, layer_versions: known}} = socket)
      when home != nil do
    if Home.list_versions(home) == known, do: socket, else: refresh(socket)
  end

  def check_saved(socket), do: socket
end
