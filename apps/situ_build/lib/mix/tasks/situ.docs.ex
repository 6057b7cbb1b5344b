defmodule Mix.Tasks.Situ.Docs do
  @shortdoc "Writes the input of the API site: Markdown of the public modules and of the guides"
  @moduledoc """
  Writes the Markdown of the API site into a folder.

      $ mix situ.docs FOLDER [--source-url URL]

  `bin/docs` runs it, and then runs the generator of the site on the folder (ADR 0003). `--source-url` is the address of
  a file in the repository. It contains `%{path}` and may contain `%{line}`.

  See `docs/adr/0003-sphinx-makes-the-api-site.md`.
  """
  use Mix.Task
  alias Situ.Build.{DocLinks, ModuleDocs, ModulePage, PublicModules, SitePages}

  @source_url "https://github.com/situ/situ/blob/main/%{path}#L%{line}"

  @impl Mix.Task
  def run(arguments) do
    {options, [folder]} = OptionParser.parse!(arguments, strict: [source_url: :string])
    root = File.cwd!()
    api = File.read!("docs/api.md")
    statuses = PublicModules.parse_list(api)
    lib = Path.join(Mix.Project.build_path(), "lib")
    modules = ModuleDocs.read_all(lib, statuses |> Map.keys() |> Enum.sort())
    pages = SitePages.list_pages(root)
    links = DocLinks.new(modules, pages, options[:source_url] || @source_url)

    SitePages.write_documents(root, folder, links)

    for module <- modules do
      page = ModulePage.render_page(module, statuses[module.name], links)
      SitePages.write_page(folder, "api/#{module.name}.html", page)
    end

    navigation = SitePages.build_navigation(File.read!("docs/README.md"), api, pages)
    File.write!(Path.join(folder, "navigation.json"), encode_json(navigation))
    Mix.shell().info("#{length(modules)} modules, #{map_size(pages)} documents")
  end

  # Elixir's inspected strings are not JSON; these titles and pages contain no escapes.
  defp encode_json(groups) do
    rows =
      for group <- groups do
        pages =
          for page <- group.pages, do: ~s({"title": "#{page.title}", "page": "#{page.page}"})

        ~s({"title": "#{group.title}", "part": "#{group.part}", "pages": [#{Enum.join(pages, ", ")}]})
      end

    "[" <> Enum.join(rows, ",\n") <> "]\n"
  end
end
