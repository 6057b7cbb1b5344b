Application.ensure_all_started(:situ_infer)
ExUnit.start()
