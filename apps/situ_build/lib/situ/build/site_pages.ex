defmodule Situ.Build.SitePages do
  @moduledoc false
  # The pages of the API site that are not made from code: guides, decisions and other documents of the checkout, and
  # the navigation.
  #
  # `docs/README.md` is the first page. Its lists of guides are the first part of the navigation, so a guide that is
  # not listed there cannot be found on the site either. The second part are the groups of `docs/api.md`.
  alias Situ.Build.{DocLinks, Markdown}

  @documents ~w(docs/*.md docs/guides/*.md docs/guides/*/*.md docs/adr/*.md CHANGELOG.md CONTRIBUTING.md SECURITY.md
                CODE_OF_CONDUCT.md bench/README.md priv/schema/*.md clients/python/README.md)
  @pictures ~w(docs/**/*.{png,svg,gif,webp,jpg} bench/*.svg)

  @doc "Returns the page of each document of the checkout at `root`."
  @spec list_pages(Path.t()) :: %{Path.t() => Path.t()}
  def list_pages(root) do
    for pattern <- @documents, path <- Path.wildcard(Path.join(root, pattern)), into: %{} do
      file = Path.relative_to(path, root)
      {file, page_name(file)}
    end
  end

  defp page_name("docs/README.md"), do: "index.html"
  defp page_name("docs/" <> rest), do: page_name(rest)
  defp page_name("bench/README.md"), do: "benchmarks.html"
  defp page_name("clients/python/README.md"), do: "python-package.html"
  defp page_name("priv/schema/" <> rest), do: "formats/" <> page_name(rest)

  defp page_name(path) do
    path
    |> String.replace(~r/README\.md$/, "index.md")
    |> String.replace_suffix(".md", ".html")
  end

  @doc "Writes the documents and pictures of the checkout at `root` into `folder`, as input of the generator."
  @spec write_documents(Path.t(), Path.t(), DocLinks.t()) :: :ok
  def write_documents(root, folder, links) do
    for {file, page} <- links.pages do
      text = File.read!(Path.join(root, file))
      write_page(folder, page, render_document(text, file, page, links))
    end

    for pattern <- @pictures, path <- Path.wildcard(Path.join(root, pattern)) do
      copy = Path.join([folder, "pictures", Path.relative_to(path, root)])
      File.mkdir_p!(Path.dirname(copy))
      File.cp!(path, copy)
    end

    :ok
  end

  @doc "Writes the Markdown of one page."
  @spec write_page(Path.t(), Path.t(), iodata()) :: :ok
  def write_page(folder, page, text) do
    path = Path.join(folder, Path.rootname(page) <> ".md")
    File.mkdir_p!(Path.dirname(path))
    File.write!(path, text)
  end

  defp render_document(text, file, page, links) do
    text = text |> Markdown.add_anchors() |> Markdown.fence_code("text")
    place = %{page: page, file: file, module: nil}
    ["---\norphan: true\ntocdepth: 3\n---\n\n", DocLinks.link_text(links, text, place)]
  end

  @doc """
  Returns the navigation: groups of pages, in the order of the two lists.

      iex> index = "## Guides\\n\\n### Tutorials\\n\\n- [Start](guides/start.md): begin here\\n"
      iex> api = "### Values\\n\\n| `Situ.Time` | stable | Points in time |\\n"
      iex> Situ.Build.SitePages.build_navigation(index, api, %{"docs/guides/start.md" => "guides/start.html"})
      [
        %{title: "Tutorials", part: "Guides", pages: [%{title: "Start", page: "guides/start.html"}]},
        %{title: "Values", part: "Modules", pages: [%{title: "Situ.Time", page: "api/Situ.Time.html"}]}
      ]
  """
  @spec build_navigation(String.t(), String.t(), %{Path.t() => Path.t()}) :: [map()]
  def build_navigation(index, api, pages) do
    guides =
      for {title, text} <- split_sections(index) do
        items =
          for [_, label, file] <- Regex.scan(~r/^- \[([^\]]+)\]\(([^)]+)\)/m, text),
              page = find_page(file, pages),
              do: %{title: label, page: page}

        %{title: title, part: "Guides", pages: items ++ made_pages(title)}
      end

    modules =
      for {title, text} <- split_sections(api) do
        items =
          for [_, name] <- Regex.scan(~r/^\| `([A-Z][\w.]*)` \|/m, text),
              do: %{title: name, page: "api/#{name}.html"}

        %{title: title, part: "Modules", pages: items}
      end

    Enum.reject(guides ++ modules, &(&1.pages == []))
  end

  # `bin/docs` makes this page with the command line.
  defp made_pages("Reference"), do: [%{title: "Command line", page: "commands.html"}]
  defp made_pages(_title), do: []

  defp find_page(file, pages), do: pages[DocLinks.collapse_path("docs/" <> file)]

  defp split_sections(text) do
    for section <- text |> String.split(~r/^### /m) |> tl() do
      [title, rest] = String.split(section, "\n", parts: 2)
      {title, rest |> String.split(~r/^## /m) |> hd()}
    end
  end
end
