defmodule Situ.Studio.Web.BookmarkList do
  @moduledoc false
  # Handles the bookmarks of the main view: the list next to the panels, and the events that change it. All pages that
  # show the item get the changes. The page's script marks them on the navigator and jumps between them.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, connected?: 1, push_event: 3]
  import Situ.Studio.Web.Icons

  alias Situ.Live.Socket
  alias Situ.Studio.Bookmarks

  @registry Situ.Studio.Peers

  @doc "Reads the bookmarks of the page's item, and subscribes to changes."
  @spec join(Socket.t()) :: Socket.t()
  def join(%{assigns: %{item: item, layout_dir: layouts, studio: studio}} = socket) do
    path = Bookmarks.document_path(item, layouts)

    if connected?(socket),
      do: {:ok, _} = Registry.register(@registry, {studio, :bookmarks, path}, nil)

    refresh(assign(socket, bookmarks: %{path: path, items: [], open: false, list: ""}))
  end

  @doc "Reads the bookmarks again."
  @spec refresh(Socket.t()) :: Socket.t()
  def refresh(%{assigns: %{bookmarks: bookmarks}} = socket) do
    case Bookmarks.read(bookmarks.path) do
      {:ok, items} -> assign(socket, bookmarks: %{bookmarks | items: items})
      {:error, error} -> show_toast(socket, error)
    end
  end

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event("bookmark_toggle", _, %{assigns: %{bookmarks: bookmarks}} = socket),
    do: assign(socket, bookmarks: %{bookmarks | open: not bookmarks.open})

  # Shows only one list, which the keys then step through.
  def handle_event(
        "bookmark_list",
        %{"list" => list},
        %{assigns: %{bookmarks: bookmarks}} = socket
      )
      when is_binary(list),
      do: assign(socket, bookmarks: %{bookmarks | list: list})

  def handle_event(_, _, %{assigns: %{read_only: true}} = socket),
    do: push_event(socket, "toast", %{text: "This studio is read-only"})

  def handle_event("bookmark_add", params, socket),
    do: edit(socket, {:add, Map.put_new(params, "list", socket.assigns.bookmarks.list)})

  def handle_event("bookmark_change", %{"id" => id} = params, socket) when is_binary(id),
    do: edit(socket, {:change, id, params})

  def handle_event("bookmark_delete", %{"id" => id}, socket) when is_binary(id),
    do: edit(socket, {:delete, id})

  def handle_event(_, _, socket), do: socket

  defp edit(%{assigns: %{bookmarks: bookmarks, studio: studio}} = socket, edit) do
    case Bookmarks.edit(bookmarks.path, edit) do
      {:ok, items} ->
        Registry.dispatch(@registry, {studio, :bookmarks, bookmarks.path}, fn pages ->
          for {pid, _} <- pages, pid != self(), do: send(pid, :bookmarks_changed)
        end)

        assign(socket, bookmarks: %{bookmarks | items: items})

      {:error, error} ->
        show_toast(socket, error)
    end
  end

  defp show_toast(socket, error),
    do: push_event(socket, "toast", %{text: Exception.message(error)})

  attr(:bookmarks, :map, required: true)
  attr(:read_only, :boolean, required: true)

  @doc false
  def bookmark_list(assigns) do
    %{items: items, list: list} = assigns.bookmarks
    lists = items |> Enum.map(& &1.list) |> Enum.uniq() |> Enum.sort() |> List.delete("")
    shown = if list == "", do: items, else: Enum.filter(items, &(&1.list == list))
    assigns = assign(assigns, items: shown, lists: lists, list: list)

    ~H"""
    <div id="bookmarks" phx-hook="Bookmarks" data-items={encode(@items)}>
    <section :if={@bookmarks.open} class="query bookmarks" aria-label="Bookmarks">
      <div class="side-title">Bookmarks<button class="mini" type="button" phx-click="bookmark_toggle"
          aria-label="Close"><.icon name={:close} /></button></div>
      <form :if={@lists != []} id="bookmark-lists" phx-change="bookmark_list">
        <select name="list" aria-label="List">
          <option value="" selected={@list == ""}>All lists</option>
          <option :for={name <- @lists} value={name} selected={@list == name}>{name}</option>
        </select>
      </form>
      <p :if={@items == []} class="hint">Nothing is marked yet.{if @read_only, do: "",
        else: " Press B to mark the cursor's time or the selection, with a comment."}</p>
      <ol :if={@items != []} class="bookmark-items">
        <li :for={item <- @items} :key={item.id} data-id={item.id} data-text={item.text} data-list={item.list}>
          <button class="go" type="button" data-go={item.id}><time data-from={Integer.to_string(item.from)}
              data-to={Integer.to_string(item.to)}></time><span>{if item.text == "", do: "(no comment)",
              else: item.text}</span><small>{describe_origin(item)}</small></button>
          <button :if={not @read_only} class="mini" type="button" data-change={item.id} title="Change"
              aria-label={"Change " <> item.text}><.icon name={:tune} /></button>
          <button :if={not @read_only} class="mini" type="button" phx-click="bookmark_delete" phx-value-id={item.id}
              title="Delete" aria-label={"Delete " <> item.text}><.icon name={:close} /></button>
        </li>
      </ol>
      <p :if={@items != []} class="hint">j and J go to the next and the previous one.</p>
    </section>
    </div>
    """
  end

  defp encode(items) do
    Situ.JSON.encode(
      for item <- items,
          do: %{item | from: Integer.to_string(item.from), to: Integer.to_string(item.to)}
    )
  end

  defp describe_origin(%{by: by, list: list}),
    do: [by, list] |> Enum.reject(&(&1 == "")) |> Enum.join(", ")
end
