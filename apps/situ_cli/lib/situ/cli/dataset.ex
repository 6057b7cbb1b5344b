defmodule Situ.CLI.Dataset do
  @moduledoc false
  # The verbs of `situ dataset`: sessions of recordings in one dataset file.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Recording, Setting, Verb}
  alias Situ.CLI.Dataset.Listing
  alias Situ.Dataset
  alias Situ.Dataset.{Checksum, Partition, Session}

  @file_argument [kind: :file, doc: "a dataset file"]
  @any [
    kind: :recording,
    doc: "a dataset file, a \\psi dataset (.pds), a folder of recordings, or a recording"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["dataset", "info"],
        aliases: ["list", "ls"],
        summary:
          "list the sessions of a dataset: partitions, spans, sizes, and missing or damaged recordings",
        arguments: [
          path: @any,
          session: [kind: :text, optional: true, doc: "one session, with its streams"]
        ],
        options: [
          Option.new(:tag, :string, "only sessions with this tag", many?: true),
          Option.new(:name, :string, "only sessions whose name matches this pattern",
            value: "PATTERN"
          )
        ],
        examples: ["situ dataset info study.json", "situ dataset info recordings --json"],
        run: &show_info/2
      },
      %Verb{
        words: ["dataset", "create"],
        summary: "create a dataset file, empty or from a folder of recordings",
        about:
          "Each folder in FOLDER becomes a session, each recording in it a partition. Paths in the file are relative.",
        arguments: [
          file: @file_argument,
          folder: [kind: :folder, optional: true, doc: "a folder of recordings, or a .pds"]
        ],
        options: [
          Option.new(:name, :string, "the dataset's name (default: the file's name)"),
          Option.new(:force, :flag, "replace an existing file", short: :f)
        ],
        examples: ["situ dataset create study/study.json study"],
        run: &create_dataset/2
      },
      %Verb{
        words: ["dataset", "add"],
        summary: "add recordings to a session, which is created if it does not exist",
        arguments: [
          file: @file_argument,
          session: [kind: :text, doc: "the session's name"],
          path: [
            kind: :recording,
            many: true,
            doc: "recordings; each becomes a partition with its name"
          ]
        ],
        options: [
          Option.new(:partition, :string, "the partition's name, for a single recording",
            value: "NAME"
          ),
          Option.new(:tag, :string, "a tag for the session", many?: true),
          Option.new(:set, :string, "metadata of the session", value: "NAME=VALUE", many?: true)
        ],
        examples: ["situ dataset add study.json p11 recordings/p11/* --tag pilot --set age=31"],
        run: &add_recordings/2
      },
      %Verb{
        words: ["dataset", "set"],
        summary: "set tags and metadata of a session, or of the dataset",
        arguments: [
          file: @file_argument,
          session: [kind: :text, optional: true, doc: "a session (default: the dataset itself)"]
        ],
        options: [
          Option.new(:tag, :string, "add this tag", many?: true),
          Option.new(:untag, :string, "remove this tag", many?: true),
          Option.new(:set, :string, "metadata; VALUE is JSON or text",
            value: "NAME=VALUE",
            many?: true
          ),
          Option.new(:unset, :string, "remove this metadata", value: "KEY", many?: true)
        ],
        examples: ["situ dataset set study.json p03 --set 'notes=came late' --tag left-handed"],
        run: &set_properties/2
      },
      %Verb{
        words: ["dataset", "rename"],
        summary: "rename a session or a partition (SESSION/PARTITION)",
        arguments: [
          file: @file_argument,
          name: [kind: :text, doc: "SESSION or SESSION/PARTITION"],
          to: [kind: :text, doc: "the new name"]
        ],
        examples: ["situ dataset rename study.json p3/lobby Room"],
        run: &rename_entry/2
      },
      %Verb{
        words: ["dataset", "remove"],
        summary:
          "remove a session or a partition (SESSION/PARTITION) from the file; recordings are not deleted",
        arguments: [
          file: @file_argument,
          name: [kind: :text, many: true, doc: "SESSION or SESSION/PARTITION"]
        ],
        examples: ["situ dataset remove study.json pilot1 p3/Room"],
        run: &remove_entries/2
      },
      %Verb{
        words: ["dataset", "append"],
        summary: "add the sessions of another dataset",
        arguments: [file: @file_argument, other: @any],
        examples: ["situ dataset append study.json monday.pds"],
        run: &append_sessions/2
      },
      %Verb{
        words: ["dataset", "seal"],
        summary: "store a checksum of every recording, so that verify can detect later changes",
        arguments: [file: @file_argument],
        run: &seal_dataset/2
      },
      %Verb{
        words: ["dataset", "verify"],
        summary:
          "check that every recording exists, is intact and (if sealed) unchanged; status 1 if not",
        arguments: [path: @any],
        run: &verify_dataset/2
      }
    ]
  end

  @doc "Opens a dataset, or any recordings that can be treated as one, after starting the applications of all formats."
  @spec open_dataset!(Path.t()) :: Dataset.t()
  def open_dataset!(path) do
    Recording.load_formats([path])
    for app <- [:situ_media, :situ_bridge], do: {:ok, _} = Application.ensure_all_started(app)
    unwrap!(Dataset.open(path))
  end

  # Other programs may edit the file concurrently, so each edit starts from its current contents.
  defp edit_file(file, opts, fun) do
    saved =
      case open_dataset!(file) do
        %{file: nil} = dataset -> unwrap!(Dataset.save(unwrap!(fun.(dataset))))
        dataset -> unwrap!(Dataset.update(dataset, fun, write: true))
      end

    if opts[:json], do: Output.print_json(%{file: saved.file, sessions: length(saved.sessions)})
    0
  end

  # Looking

  defp show_info(%{path: path, session: nil}, opts),
    do: path |> open_dataset!() |> Listing.list_sessions(opts)

  defp show_info(%{path: path, session: name}, opts),
    do:
      path |> open_dataset!() |> Dataset.session(name) |> unwrap!() |> Listing.show_session(opts)

  # Changing

  defp create_dataset(%{file: file, folder: folder}, opts) do
    if File.exists?(file) and not opts[:force] do
      raise Situ.Error.new(:file_exists, "#{file} already exists",
              fix: "choose another name, or give --force"
            )
    end

    dataset = if folder, do: open_dataset!(folder), else: unwrap!(Dataset.new())
    name = opts[:name] || Path.basename(file, Path.extname(file))
    dataset = unwrap!(Dataset.put_fields(dataset, name: name))
    saved = unwrap!(Dataset.save_as(dataset, file))

    if opts[:json],
      do: Output.print_json(%{file: saved.file, sessions: length(saved.sessions)}),
      else:
        Output.puts("#{saved.file}: #{Output.format_count(length(saved.sessions), "session")}")

    0
  end

  defp add_recordings(%{file: file, session: name, path: paths}, opts) do
    paths = Recording.expand_patterns(paths)

    if opts[:partition] && length(paths) > 1,
      do: throw({:usage, "--partition needs exactly one recording, not #{length(paths)}"})

    partitions = Enum.map(paths, &open_partition!(opts[:partition], &1))

    edit_file(file, opts, fn dataset ->
      dataset =
        case Dataset.session(dataset, name) do
          {:ok, _} -> dataset
          {:error, _} -> unwrap!(Dataset.add_session(dataset, name))
        end

      Dataset.update_session(dataset, name, fn session ->
        session = Enum.reduce(partitions, session, &unwrap!(Session.add_partition(&2, &1)))
        {:ok, apply_changes(session, opts)}
      end)
    end)
  end

  # A path that cannot be opened now is most likely a typing error.
  defp open_partition!(name, path) do
    Recording.load_formats([path])
    partition = Partition.new(name, path)
    _ = unwrap!(Partition.open(partition))
    partition
  end

  defp set_properties(%{file: file, session: nil}, opts) do
    edit_file(file, opts, fn dataset ->
      changed = apply_changes(dataset, opts)
      Dataset.put_fields(dataset, tags: changed.tags, metadata: changed.metadata)
    end)
  end

  defp set_properties(%{file: file, session: name}, opts),
    do:
      edit_file(
        file,
        opts,
        &Dataset.update_session(&1, name, fn session -> {:ok, apply_changes(session, opts)} end)
      )

  defp apply_changes(thing, opts) do
    tags = Enum.uniq(thing.tags ++ opts[:tag]) -- (opts[:untag] || [])
    metadata = Enum.into(Setting.parse_settings(opts[:set]), thing.metadata)
    %{thing | tags: tags, metadata: Map.drop(metadata, opts[:unset] || [])}
  end

  defp rename_entry(%{file: file, name: name, to: to}, opts) do
    edit_file(file, opts, fn dataset ->
      case split_name(dataset, name) do
        {session, nil} ->
          Dataset.rename_session(dataset, session, to)

        {session, partition} ->
          Dataset.update_session(dataset, session, &Session.rename_partition(&1, partition, to))
      end
    end)
  end

  defp remove_entries(%{file: file, name: names}, opts) do
    edit_file(file, opts, fn dataset ->
      Enum.reduce(names, {:ok, dataset}, fn name, {:ok, dataset} ->
        removed =
          case split_name(dataset, name) do
            {session, nil} ->
              Dataset.remove_session(dataset, session)

            {session, partition} ->
              Dataset.update_session(dataset, session, &Session.remove_partition(&1, partition))
          end

        {:ok, unwrap!(removed)}
      end)
    end)
  end

  # The name of a session may contain a slash.
  defp split_name(dataset, name) do
    with {:error, _} <- Dataset.session(dataset, name),
         [session, partition] <- String.split(name, "/", parts: 2) do
      {session, partition}
    else
      _ -> {name, nil}
    end
  end

  defp append_sessions(%{file: file, other: other}, opts) do
    other = open_dataset!(other)
    edit_file(file, opts, &Dataset.append_sessions(&1, other))
  end

  # Checksums take a long time, so they are computed before the file is opened for editing.
  defp seal_dataset(%{file: file}, opts) do
    partitions = file |> open_dataset!() |> Dataset.list_partitions()

    checksums =
      Progress.with_progress("seal", opts, fn progress ->
        unwrap!(Checksum.compute_all(partitions, progress: progress))
      end)

    edit_file(file, opts, &Dataset.put_checksums(&1, checksums))
  end

  defp verify_dataset(%{path: path}, opts) do
    dataset = open_dataset!(path)
    total = dataset.sessions |> Enum.map(&length(&1.partitions)) |> Enum.sum()

    all =
      for session <- dataset.sessions, partition <- session.partitions, do: {session, partition}

    wrong =
      Progress.with_progress("verify", opts, fn progress ->
        for {{session, partition}, n} <- Enum.with_index(all, 1),
            progress.(n, total) || true,
            {:error, error} <- [verify_partition(partition)],
            do: {session.name, partition.name, error}
      end)

    if opts[:json] do
      Output.print_json(
        for {s, p, e} <- wrong,
            do: %{session: s, partition: p, code: e.code, what: e.what, why: e.why}
      )
    else
      for {s, p, e} <- wrong, do: Output.puts("#{s}/#{p}: #{Exception.message(e)}")
      if wrong == [], do: Output.puts("#{Output.format_count(total, "recording")}, all intact")
    end

    if wrong == [], do: 0, else: 1
  end

  defp verify_partition(partition) do
    with :ok <- Partition.check_recording(partition) do
      if partition.checksum, do: Checksum.verify(partition.path, partition.checksum), else: :ok
    end
  end

  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end
