defmodule Situ.Build.DocLinks do
  @moduledoc false
  # Links in the Markdown of documentation: `Situ.Store.open/2` in backticks becomes a link to the function, and a link
  # to a file of the checkout becomes a link to its page or to its source.
  #
  # Code blocks, headings and the text of existing links stay as they are.

  alias Situ.Build.ModuleDocs

  @enforce_keys [:targets, :pages, :source_url]
  defstruct [:targets, :pages, :source_url]

  @typedoc """
  `targets` maps `{module, kind, name, arity}` and `{module}` to the page and anchor. `pages` maps files of the checkout
  to pages. `source_url` is the address of a file in the repository, with `%{path}` and `%{line}`.
  """
  @type t :: %__MODULE__{targets: map(), pages: %{Path.t() => Path.t()}, source_url: String.t()}

  @typedoc "The page that shows a text, the file that contains it, and the module whose functions it may name alone."
  @type place :: %{page: Path.t(), file: Path.t(), module: String.t() | nil}

  @code Enum.join(
          [
            # Blocks of code and headings, which stay as they are.
            ~S"(?<fence>^ *(?<tick>```|~~~).*?^ *\k<tick> *$)",
            ~S"(?<block>^(?: {4}|\t)[^\n]*$)",
            ~S"(?<head>^\#{1,6} [^\n]*$)",
            ~S"(?<image>!\[(?<alt>[^\]]*)\]\((?<src>[^)\s]+)\))",
            ~S"(?<link>\[(?<label>(?:[^\[\]]|`[^`]*`)*)\]\((?<url>[^)\s]+)\))",
            ~S"(?<double>``.*?``)",
            ~S"`(?<span>[^`]+)`"
          ],
          "|"
        )
  @name "^(?:(?<kind>[tcm]):)?(?:(?<module>[A-Z]\\w*(?:\\.[A-Z]\\w*)*)(?:\\.|$))?" <>
          "(?:(?<name>[a-z_]\\w*[?!]?)\\/(?<arity>\\d+))?$"

  @doc "Collects the targets of these modules, whose pages are `api/NAME.html`."
  @spec new([ModuleDocs.t()], %{Path.t() => Path.t()}, String.t()) :: t()
  def new(modules, pages, source_url) do
    targets =
      for module <- modules, {key, target} <- module_targets(module), into: %{}, do: {key, target}

    %__MODULE__{targets: targets, pages: pages, source_url: source_url}
  end

  defp module_targets(module) do
    page = "api/#{module.name}.html"

    entries =
      for entry <- module.entries, arity <- entry.arities do
        {{module.name, anchor_kind(entry.kind), to_string(entry.name), arity},
         page <> "#" <> anchor(entry)}
      end

    [{{module.name}, page} | entries]
  end

  @doc """
  Returns the anchor of a function, type or callback on its module's page, as ExDoc names it.

      iex> Situ.Build.DocLinks.anchor(%{kind: :type, name: :t, arity: 0})
      "t:t/0"
      iex> Situ.Build.DocLinks.anchor(%{kind: :function, name: :open!, arity: 2})
      "open!/2"
  """
  @spec anchor(%{:kind => atom(), :name => atom(), :arity => arity(), optional(atom()) => term()}) ::
          String.t()
  def anchor(entry), do: anchor_kind(entry.kind) <> "#{entry.name}/#{entry.arity}"

  defp anchor_kind(:type), do: "t:"
  defp anchor_kind(kind) when kind in [:callback, :macrocallback], do: "c:"
  defp anchor_kind(_kind), do: ""

  @doc "Returns the address of a line of a file in the repository."
  @spec source_link(t(), Path.t(), non_neg_integer() | nil) :: String.t()
  def source_link(links, path, line \\ nil) do
    url =
      if line,
        do: links.source_url,
        else: String.replace(links.source_url, ~r/[#?][^#?]*%\{line\}.*$/, "")

    url |> String.replace("%{path}", path) |> String.replace("%{line}", to_string(line))
  end

  @doc "Returns `text` with its links."
  @spec link_text(t(), String.t(), place()) :: String.t()
  def link_text(links, text, place) do
    code = Regex.compile!(@code, "ms")

    code
    |> Regex.split(text, include_captures: true)
    |> Enum.map_join(fn part ->
      case Regex.named_captures(code, part) do
        nil -> part
        captures -> replace_match(links, place, captures, part)
      end
    end)
  end

  @doc """
  Returns one sentence for each function of a public module that a text names and that does not exist.

      iex> links = %Situ.Build.DocLinks{targets: %{{"A"} => "", {"A", "", "f", 1} => ""}, pages: %{}, source_url: ""}
      iex> Situ.Build.DocLinks.find_unknown(links, [{"x.md", "`A.f/1`, `A.f/2` and `B.f/1`"}])
      ["x.md names A.f/2, which does not exist"]
  """
  @spec find_unknown(t(), [{String.t(), String.t()}]) :: [String.t()]
  def find_unknown(links, texts) do
    for {place, text} <- texts,
        [_, kind, module, name, arity] <-
          Regex.scan(~r/`(?:([tc]):)?([A-Z][\w.]*)\.([a-z_]\w*[?!]?)\/(\d+)`/, text),
        is_map_key(links.targets, {module}),
        find_function(links, module, kind, name, String.to_integer(arity)) == nil,
        do: "#{place} names #{module}.#{name}/#{arity}, which does not exist"
  end

  defp replace_match(links, place, %{"url" => url, "label" => label}, _whole) when url != "",
    do: "[#{label}](#{resolve_link(links, place, url)})"

  # Pictures keep their path in the checkout, below a folder of the site's sources.
  defp replace_match(_links, place, %{"src" => src, "alt" => alt}, whole) when src != "" do
    if src =~ ~r/^[a-z]+:/, do: whole, else: "![#{alt}](/pictures/#{file_path(place, src)})"
  end

  defp replace_match(links, place, %{"span" => span}, whole) when span != "" do
    case find_target(links, place, String.replace(span, ~r/\s+/, " ")) do
      nil -> whole
      target -> "[#{whole}](#{relative_link(place.page, target)})"
    end
  end

  defp replace_match(_links, _place, _captures, whole), do: whole

  defp find_target(links, place, code) do
    case Regex.named_captures(Regex.compile!(@name), code) do
      nil ->
        nil

      %{"name" => "", "module" => module} ->
        own_page? = "api/#{module}.html" == place.page
        if own_page?, do: nil, else: links.targets[{module}]

      %{"name" => name, "module" => module, "kind" => kind, "arity" => arity} ->
        module = if module == "", do: place.module, else: module
        find_function(links, module, kind, name, String.to_integer(arity))
    end
  end

  defp find_function(links, module, "", name, arity),
    do: links.targets[{module, "", name, arity}] || links.targets[{module, "c:", name, arity}]

  defp find_function(links, module, kind, name, arity),
    do: links.targets[{module, kind <> ":", name, arity}]

  @doc "Returns the typespec `code` as HTML, with links to the types of public modules."
  @spec link_code(t(), String.t(), place()) :: String.t()
  def link_code(links, code, place) do
    code = escape_html(code)

    Regex.replace(~r/\b(?:([A-Z]\w*(?:\.[A-Z]\w*)*)\.)?([a-z_]\w*)\(\)/, code, fn whole,
                                                                                  module,
                                                                                  name ->
      module = if module == "", do: place.module, else: module

      case links.targets[{module, "t:", name, 0}] do
        nil -> whole
        target -> ~s(<a href="#{relative_link(place.page, target)}">#{whole}</a>)
      end
    end)
  end

  @doc """
  Escapes a text for HTML.

      iex> Situ.Build.DocLinks.escape_html("a < b")
      "a &lt; b"
  """
  @spec escape_html(String.t()) :: String.t()
  def escape_html(text) do
    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
  end

  defp resolve_link(links, place, url) do
    if url =~ ~r/^([a-z]+:|#|\/)/i, do: url, else: resolve_file(links, place, url)
  end

  defp resolve_file(links, place, url) do
    {file, fragment} =
      case String.split(url, "#", parts: 2) do
        [file] -> {file, ""}
        [file, fragment] -> {file, "#" <> fragment}
      end

    path = file_path(place, file)

    case links.pages[path] do
      nil -> source_link(links, path) <> fragment
      page -> relative_link(place.page, page) <> fragment
    end
  end

  defp file_path(place, file),
    do: place.file |> Path.dirname() |> Path.join(file) |> collapse_path()

  @doc """
  Removes `..` and `.` from a relative path.

      iex> Situ.Build.DocLinks.collapse_path("docs/guides/../api.md")
      "docs/api.md"
  """
  @spec collapse_path(Path.t()) :: Path.t()
  def collapse_path(path), do: path |> Path.expand("/") |> Path.relative_to("/")

  @doc """
  Returns the link from one page of the site to another.

      iex> Situ.Build.DocLinks.relative_link("guides/a.html", "api/Situ.html#map/2")
      "../api/Situ.html#map/2"
      iex> Situ.Build.DocLinks.relative_link("index.html", "api.html")
      "api.html"
  """
  @spec relative_link(Path.t(), Path.t()) :: String.t()
  def relative_link(from, to) do
    from |> Path.split() |> tl() |> Enum.map_join(fn _ -> "../" end) |> Kernel.<>(to)
  end
end
