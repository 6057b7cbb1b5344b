# A studio in a separate VM, for the test that kills it: FOLDER PORT LAYOUTS. Prints its address.
[folder, port, layouts] = System.argv()
{:ok, _} = Application.ensure_all_started(:situ_studio)

unless File.exists?(Path.join(folder, "lasting.0000")) do
  Code.require_file("fixture.exs", __DIR__)
  Fixture.record_uneven("lasting", folder)
end

{:ok, studio} =
  Situ.Studio.start_link(path: folder, port: String.to_integer(port), layouts: layouts)

IO.puts("ready #{Situ.Studio.port(studio)}")
Process.sleep(:infinity)
