# Makes the dataset of the guide in a folder: `clips.exs FOLDER`.
for app <- [:situ_examples, :situ_dataset, :situ_media],
    do: {:ok, _} = Application.ensure_all_started(app)

[folder] = System.argv()
demo = Application.app_dir(:situ_examples, "priv/demo")

clips =
  for name <- ~w(talk2 talk3),
      do: {Path.join(demo, name <> ".mp4"), Path.join(demo, name <> ".truth.json")}

{:ok, dataset} = Situ.Examples.ClipVariants.create_dataset(clips, folder)
10 = length(dataset.sessions)
